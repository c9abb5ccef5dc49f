"""What the calibration of an arm leaves of its errors, with their correlations, and how it displaces a tool.

Looks at spheres separate a link from its neighbour, or the last one from the head on the flange, far worse
than they determine what both do to the tool together. As independent errors of the same sizes they would
displace it several times as far.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm_geometry import (
    HARMONIC_RAD,
    JOINT_OFFSET_RAD,
    LINK_ROTATION_RAD,
    LINK_TRANSLATION_MM,
    error_columns,
)
from ronna_hw.arm.deviations import FLANK_SHARE, flange_rotations, gravity_levers
from ronna_hw.arm.kinematics import Chain

if TYPE_CHECKING:
    from ronna_hw.calibration import ArmCalibration

Array = NDArray[np.float64]

ONCE_RAD, TWICE_RAD = HARMONIC_RAD
LINK = [LINK_TRANSLATION_MM, LINK_ROTATION_RAD]
SIZES = np.array([JOINT_OFFSET_RAD, ONCE_RAD, ONCE_RAD, TWICE_RAD, TWICE_RAD, *LINK, *LINK, *LINK])
OFFSET, SINE, COSINE, TRANSLATION, ROTATION = [0], [1, 3], [2, 4], [5, 7, 9], [6, 8, 10]  # of each joint


@dataclass(frozen=True, eq=False)
class IdentifiedArm:
    """`remaining` (k, k), times its transpose, is the covariance of the errors as ordered in `by_deviation`.

    `backlash_rad` (axes,); `scatter_mm` is the random error per axis from pose to pose, including what
    the model of the arm does not describe.
    """

    remaining: Array
    backlash_rad: Array
    scatter_mm: float

    @classmethod
    def of(cls, record: ArmCalibration) -> Self | None:
        """From a record; None from one that does not state the covariance."""
        if record.remaining is None:
            return None
        remaining = np.zeros((len(record.remaining), len(record.remaining)))
        remaining[np.tril_indices(len(remaining))] = np.concatenate(record.remaining)
        return cls(remaining, np.array(record.backlash_rad), record.scatter_mm)


def by_deviation(chain: Chain, joints_rad: Array, points_mm: Array, sides: Array) -> Array:
    """Displacement (p, 3, k) of points (p, 3) mm fixed to the flange, robot frame, per mm or rad.

    In the order of `ArmDeviations.flat`; then x, y, z of the head on the flange. `joints_rad` and `sides`, of
    the backlash on which each joint rests, are (p, axes).
    """
    columns = error_columns(chain, joints_rad, points_mm)
    by_joint = columns.reshape(*columns.shape[:2], -1, len(SIZES)) / SIZES
    swings = by_joint[..., 0]
    fields = [by_joint[..., of] for of in (TRANSLATION, ROTATION, OFFSET, SINE, COSINE)]
    sag = swings * gravity_levers(chain, joints_rad)[:, None]
    backlash = FLANK_SHARE * swings * sides[:, None]
    flat = [one.reshape(*columns.shape[:2], -1) for one in (*fields, sag, backlash)]
    return np.concatenate([*flat, flange_rotations(chain, joints_rad)], axis=2)
