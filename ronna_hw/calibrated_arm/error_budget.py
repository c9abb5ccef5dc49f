"""Error budget of an arm: its geometric errors and the tool displacement each one causes.

An uncalibrated arm is off by tenths of a millimetre, and not at random: errors of length and twist of each
link are the same in all views. Each kind of error is one column here. Sizes are those of an uncalibrated arm
(parameter set S of the error study) unless given.

Errors of the last link are equivalent to an offset of the tool centre: no view can separate the two. Their
size per axis limits any calibration with a ball and an uncalibrated arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array, cross
from ronna_hw.calibrated_arm.deviations import FLANK_SHARE, flange_rotations, gravity_levers
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import ProcedureSettings

# One standard deviation each for an uncalibrated arm of this class: parameter set S of the error study, which
# was chosen so that the means of table 4 of the thesis come out, and not measured.
LINK_TRANSLATION_MM = 0.40
LINK_ROTATION_RAD = float(np.radians(0.05))
JOINT_OFFSET_RAD = float(np.radians(0.05))
HARMONIC_RAD = (float(np.radians(0.015)), float(np.radians(0.008)))  # once and twice per turn of the joint
# An arm with a larger error per axis and view counts as uncalibrated; the best of thirty random arms
# reaches this value. For a smaller error the geometry is assumed proportionally better; the last
# link's part never shows.
UNCALIBRATED_MM = 0.10
X, Y, Z = np.eye(3)

ONCE_RAD, TWICE_RAD = HARMONIC_RAD
LINK = [LINK_TRANSLATION_MM, LINK_ROTATION_RAD]
SIZES = np.array([JOINT_OFFSET_RAD, ONCE_RAD, ONCE_RAD, TWICE_RAD, TWICE_RAD, *LINK, *LINK, *LINK])
OFFSET, SINE, COSINE, TRANSLATION, ROTATION = [0], [1, 3], [2, 4], [5, 7, 9], [6, 8, 10]  # of each joint

# also of set S; harmonics have an arbitrary phase
SAG_RAD = math.radians(0.03)
BACKLASH_RAD = math.radians(0.02)
TOOL_MM = 2.0

PER_JOINT = 11  # columns: offset, four of harmonics, six of the link
HARMONIC_COLUMNS = slice(1, 5)
PER_AXIS = 3.0**-0.5  # of a 3-D error
EVEN_PHASE = 0.5**0.5  # rms sine and cosine component of a harmonic of arbitrary phase
SAGGING = (1, 2)  # joints, counted from 0


@dataclass(frozen=True)
class ErrorSizes:
    """Residual arm errors as fractions of parameter set S; tool-frame errors in mm per axis.

    `links` includes the joint offsets, `joints` harmonics and sag. `backlash` is the fraction remaining if it
    is known on which side a joint rests; otherwise all of it remains. Predictions for an `identified` arm use
    its covariance instead of independent errors of these sizes.
    """

    tool_mm: float = TOOL_MM
    links: float = 1.0
    joints: float = 1.0
    backlash: float = 1.0
    identified: IdentifiedArm | None = None

    @classmethod
    def stated(cls, settings: ProcedureSettings, arm: ArmCalibration | None) -> Self:
        """Return the sizes from the arm's record, capped at set S, or set S itself without a record.

        Without a record the settings give the error of the tool frame. It is at least that of the last link:
        no measurement separates the two.
        """
        share = min(1.0, arm_error_mm(settings, arm) / UNCALIBRATED_MM)
        if arm is None:
            tool_mm = max(settings.tool_error_mm, LINK_TRANSLATION_MM)
        else:
            tool_mm = arm.tool_error_mm or PER_AXIS * arm.stated_error_mm
        return cls(tool_mm, share, share, share, None if arm is None else IdentifiedArm.of(arm))


def arm_error_mm(settings: ProcedureSettings, arm: ArmCalibration | None) -> float:
    """Return the arm's local error per axis, mm, from its record or, failing that, the settings.

    Without a record it is at least that of an uncalibrated arm.

    If a record states only the error of a point, the result is that between two points: errors at the spheres
    and at the target differ.
    """
    if arm is None:
        return max(settings.arm_error_mm, UNCALIBRATED_MM)
    return arm.arm_error_mm or 2.0**0.5 * PER_AXIS * arm.stated_error_mm


@dataclass(frozen=True, eq=False)
class IdentifiedArm:
    """Residual errors of a calibrated arm, with their correlations.

    Views of spheres hardly separate a link from its neighbour, or the last link from the head on the flange.
    They determine the combined displacement of the tool far better. Independent errors of these sizes would
    displace it several times as far. `remaining` (k, k), times its transpose, is the covariance of the errors
    as ordered in `by_deviation`. `backlash_rad` (axes,); `scatter_mm` is the random error per axis from pose
    to pose, including what the arm's model does not describe. Both sizes were estimated from `freedom`
    degrees of freedom; None if the record does not say.
    """

    remaining: Array
    backlash_rad: Array
    scatter_mm: float
    freedom: float | None = None

    @classmethod
    def of(cls, record: ArmCalibration) -> Self | None:
        """Read the errors from a record, or return None if it has no covariance."""
        if record.remaining is None:
            return None
        remaining = np.zeros((len(record.remaining), len(record.remaining)))
        remaining[np.tril_indices(len(remaining))] = np.concatenate(record.remaining)
        return cls(remaining, np.array(record.backlash_rad), record.scatter_mm, record.freedom)


def backlash_mm2(chain: Chain, joints_rad: Array, points_mm: Array, sizes: ErrorSizes) -> Array:
    """Return tool covariances (p, 3, 3) at points (p, 3) mm due to backlash of unknown side."""
    arm = sizes.identified
    backlash_rad = BACKLASH_RAD if arm is None else arm.backlash_rad
    half = FLANK_SHARE * backlash_rad * displacements(chain, joints_rad, points_mm, sizes).swings_mm
    return np.asarray(half @ half.transpose(0, 2, 1))


@dataclass(frozen=True)
class Displacements:
    """Tool displacement at `p` poses due to each error of one standard deviation."""

    links_mm: Array  # (p, 3, k)
    joints_mm: Array  # (p, 3, m) harmonics, then sag
    swings_mm: Array  # (p, 3, axes) by each joint, mm per rad


def displacements(chain: Chain, joints_rad: Array, points_mm: Array, sizes: ErrorSizes) -> Displacements:
    """Compute the tool displacement due to each error, at joints (p, axes) and tool origins (p, 3) mm."""
    columns = error_columns(chain, joints_rad, points_mm)
    by_joint = columns.reshape(*columns.shape[:2], -1, PER_JOINT)
    swings = by_joint[..., 0] / JOINT_OFFSET_RAD
    links = np.delete(by_joint, HARMONIC_COLUMNS, axis=3).reshape(len(columns), 3, -1)
    harmonics = EVEN_PHASE * by_joint[..., HARMONIC_COLUMNS].reshape(len(columns), 3, -1)
    levers = gravity_levers(chain, joints_rad)
    sag = SAG_RAD * np.stack([swings[..., item] * levers[:, item, None] for item in SAGGING], axis=-1)
    return Displacements(sizes.links * links, sizes.joints * np.concatenate([harmonics, sag], axis=2), swings)


def error_columns(chain: Chain, joints_rad: ArrayLike, ball_mm: Array) -> Array:
    """Return displacements (n, 3, k) in mm of a flange-fixed point at `ball_mm` in the robot frame.

    One column per error, at one standard deviation: six for every link at its far end, offset and harmonics
    for every joint. `joints_rad` is (n, axes).
    """
    angles = np.asarray(joints_rad, dtype=float)
    place = np.tile(chain.base_mm, (len(angles), 1))
    turned = np.tile(np.eye(3), (len(angles), 1, 1))  # robot <- link
    columns: list[Array] = []
    for joint, (axis_of_joint, to_next_mm) in enumerate(chain.joints):
        axis = np.array(axis_of_joint)
        swing = cross(turned @ axis, ball_mm - place)  # of the ball, per radian of this joint
        columns.append(JOINT_OFFSET_RAD * swing)
        for order, size_rad in enumerate(HARMONIC_RAD, start=1):
            phase = order * angles[:, joint, None]
            columns += [size_rad * np.sin(phase) * swing, size_rad * np.cos(phase) * swing]
        turned = turned @ Rotation.from_rotvec(angles[:, joint, None] * axis).as_matrix()
        place = place + turned @ np.array(to_next_mm)
        for direction in (X, Y, Z):
            columns.append(LINK_TRANSLATION_MM * (turned @ direction))
            columns.append(LINK_ROTATION_RAD * cross(turned @ direction, ball_mm - place))
    return np.stack(columns, axis=2)


def by_deviation(chain: Chain, joints_rad: Array, points_mm: Array, sides: Array) -> Array:
    """Return displacements (p, 3, k), per mm or rad, of flange-fixed points (p, 3) mm in the robot frame.

    In the order of `ArmDeviations.flat`; then x, y, z of the head on the flange. `joints_rad` and `sides`,
    the side of its backlash on which each joint rests, are (p, axes).
    """
    columns = error_columns(chain, joints_rad, points_mm)
    by_joint = columns.reshape(*columns.shape[:2], -1, len(SIZES)) / SIZES
    swings = by_joint[..., 0]
    fields = [by_joint[..., of] for of in (TRANSLATION, ROTATION, OFFSET, SINE, COSINE)]
    sag = swings * gravity_levers(chain, joints_rad)[:, None]
    backlash = FLANK_SHARE * swings * sides[:, None]
    flat = [item.reshape(*columns.shape[:2], -1) for item in (*fields, sag, backlash)]
    return np.concatenate([*flat, flange_rotations(chain, joints_rad)], axis=2)


def unit_errors(
    chain: Chain,
    joints_rad: Array,
    points_mm: Array,
    sizes: ErrorSizes,
    sides: Array,
    moved: Displacements | None = None,
) -> Array:
    """Return displacements (p, 3, k) mm of flange-fixed points (p, 3) mm by each unit error of arm and tool.

    The errors are independent, of unit variance and the same in all poses. Arguments as in `by_deviation`;
    `moved` is given by callers who have computed it.
    """
    if sizes.identified is not None:
        return by_deviation(chain, joints_rad, points_mm, sides) @ sizes.identified.remaining
    if moved is None:
        moved = displacements(chain, joints_rad, points_mm, sizes)
    tool = sizes.tool_mm * flange_rotations(chain, joints_rad)
    backlash = sizes.backlash * BACKLASH_RAD * FLANK_SHARE * moved.swings_mm * sides[:, None]
    return np.concatenate([moved.links_mm, moved.joints_mm, backlash, tool], axis=2)


UNCALIBRATED = ErrorSizes()
