"""An arm's errors as sources of a predicted target error: how each displaces the tool at every pose.

Sizes are those of an uncalibrated arm (parameter set S of the error study) unless given, or what the
calibration of the arm has left, correlations included.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.calibration.arm.error_model import BACKLASH_RAD, SAG_RAD, TOOL_MM
from procedures.calibration.arm_geometry import (
    JOINT_OFFSET_RAD,
    LINK_TRANSLATION_MM,
    UNCALIBRATED_MM,
    error_columns,
)
from procedures.calibration.identified_arm import IdentifiedArm, by_deviation
from procedures.registration.target_prediction import OwnErrors, SharedErrors
from ronna_hw.arm.deviations import FLANK_SHARE, flange_rotations, gravity_levers
from ronna_hw.arm.kinematics import Chain

if TYPE_CHECKING:
    from ronna_hw.calibration import ArmCalibration
    from ronna_hw.config import ProcedureSettings

Array = NDArray[np.float64]

REPEATABILITY_MM = 0.015  # per axis, at rest
SERVO_MM = 0.03  # 3-D rms of the servo's residual
PER_JOINT = 11  # columns: offset, four of harmonics, six of the link
HARMONIC_COLUMNS = slice(1, 5)
PER_AXIS = 3.0**-0.5  # of a 3-D error
EVEN_PHASE = 0.5**0.5  # rms sine and cosine component of a harmonic of arbitrary phase
SAGGING = (1, 2)  # joints, counted from 0


@dataclass(frozen=True)
class ErrorSizes:
    """Remaining errors of an arm as fractions of set S; the tool frame's in mm per axis.

    `links` includes the joint offsets, `joints` harmonics and sag. `backlash` is the fraction remaining if it
    is known on which side a joint rests; otherwise all of it remains. Of an `identified` arm, predictions use
    what is known of it instead of independent errors of these sizes.
    """

    tool_mm: float = TOOL_MM
    links: float = 1.0
    joints: float = 1.0
    backlash: float = 1.0
    identified: IdentifiedArm | None = None

    @classmethod
    def stated(cls, settings: ProcedureSettings, arm: ArmCalibration | None) -> Self:
        """As the record of the arm states, up to all of set S; without a record all of it.

        Only without one the settings say how well the tool frame is known: no better than the last link,
        whose error no measurement separates from one of the tool frame.
        """
        share = min(1.0, arm_error_mm(settings, arm) / UNCALIBRATED_MM)
        if arm is None:
            tool_mm = max(settings.tool_error_mm, LINK_TRANSLATION_MM)
        else:
            tool_mm = arm.tool_error_mm or PER_AXIS * arm.stated_error_mm
        return cls(tool_mm, share, share, share, None if arm is None else IdentifiedArm.of(arm))


def arm_error_mm(settings: ProcedureSettings, arm: ArmCalibration | None) -> float:
    """Local error of the arm per axis: from its record, else as set, but not below the best arms.

    A record that states only the error of a point counts it between two points: what identification leaves is
    not alike at the spheres and at the target.
    """
    if arm is None:
        return max(settings.arm_error_mm, UNCALIBRATED_MM)
    return arm.arm_error_mm or 2.0**0.5 * PER_AXIS * arm.stated_error_mm


UNCALIBRATED = ErrorSizes()


@dataclass(frozen=True)
class ArmPoses:
    """Poses of the arm: joints (p, axes), tool origins (p, 3) mm in the robot frame.

    `sides` (p, axes), -1 or 1, give the side of its backlash on which each joint rests; None if unknown.
    """

    joints_rad: Array
    points_mm: Array
    sides: Array | None


def arm_sources(
    chain: Chain,
    spheres: ArmPoses,
    target: ArmPoses,
    sizes: ErrorSizes = UNCALIBRATED,
    servo_mm: float = SERVO_MM,
) -> tuple[SharedErrors | OwnErrors, ...]:
    """Geometry, joints, backlash, repeatability and tool frame, for one target and its `n` spheres.

    Repeatability is the same in all arms that are not identified. `servo_mm` is 0 if the servo's residual is
    measured.
    """
    joints = np.concatenate([spheres.joints_rad, target.joints_rad])
    points = np.concatenate([spheres.points_mm, target.points_mm])
    moved, arm = displacements(chain, joints, points, sizes), sizes.identified
    if arm is not None:
        sides = [np.zeros_like(at.joints_rad) if at.sides is None else at.sides for at in (spheres, target)]
        columns = by_deviation(chain, joints, points, np.concatenate(sides))
        unknown = _backlash(moved.swings_mm * arm.backlash_rad, spheres.sides, target.sides, 0.0)
        return (
            _shared("arm and tool frame as identified", columns @ arm.remaining),
            *([unknown] if isinstance(unknown, OwnErrors) else []),
            _at_rest(len(spheres.joints_rad), servo_mm, arm.scatter_mm),
        )
    return (
        _shared("links and joint offsets", moved.links_mm),
        _shared("harmonics and sag", _sag_added(moved.joints_mm)),
        _backlash(BACKLASH_RAD * moved.swings_mm, spheres.sides, target.sides, sizes.backlash),
        _at_rest(len(spheres.joints_rad), servo_mm, REPEATABILITY_MM),
        # It turns with the flange; the same in all directions.
        _shared("tool frame", sizes.tool_mm * flange_rotations(chain, joints)),
    )


def backlash_mm2(chain: Chain, joints_rad: Array, points_mm: Array, sizes: ErrorSizes) -> Array:
    """Covariances (p, 3, 3) of a tool at points (p, 3) mm that rests on an unknown side of every backlash."""
    arm = sizes.identified
    backlash_rad = BACKLASH_RAD if arm is None else arm.backlash_rad
    half = FLANK_SHARE * backlash_rad * displacements(chain, joints_rad, points_mm, sizes).swings_mm
    return np.asarray(half @ half.transpose(0, 2, 1))


@dataclass(frozen=True)
class Displacements:
    """Displacement of a tool at `p` poses by each error at one standard deviation."""

    links_mm: Array  # (p, 3, k)
    joints_mm: Array  # (p, 3, m) harmonics, then sag
    swings_mm: Array  # (p, 3, axes) by each joint, mm per rad


def displacements(chain: Chain, joints_rad: Array, points_mm: Array, sizes: ErrorSizes) -> Displacements:
    """At joints (p, axes) with the tool origin at points (p, 3) mm in the robot frame."""
    columns = error_columns(chain, joints_rad, points_mm)
    by_joint = columns.reshape(*columns.shape[:2], -1, PER_JOINT)
    swings = by_joint[..., 0] / JOINT_OFFSET_RAD
    links = np.delete(by_joint, HARMONIC_COLUMNS, axis=3).reshape(len(columns), 3, -1)
    harmonics = EVEN_PHASE * by_joint[..., HARMONIC_COLUMNS].reshape(len(columns), 3, -1)
    levers = gravity_levers(chain, joints_rad)
    sag = SAG_RAD * np.stack([swings[..., one] * levers[:, one, None] for one in SAGGING], axis=-1)
    return Displacements(sizes.links * links, sizes.joints * np.concatenate([harmonics, sag], axis=2), swings)


def ct_errors(covariance_mm2: ArrayLike, source: str = "CT") -> OwnErrors:
    """Errors of the spheres in the CT, (n, 3, 3) mm2 in the robot frame."""
    return OwnErrors(source, np.asarray(covariance_mm2, dtype=float), np.zeros((3, 3)))


def _sag_added(joints_mm: Array) -> Array:
    """Weight bends all joints the same way: what they sag adds up, which independent errors would not."""
    harmonics, sag = np.split(joints_mm, [-len(SAGGING)], axis=2)
    return np.concatenate([harmonics, sag.sum(axis=2, keepdims=True)], axis=2)


def _shared(source: str, columns_mm: Array) -> SharedErrors:
    return SharedErrors(source, columns_mm[:-1], columns_mm[-1])


def _backlash(
    whole: Array, at_spheres: Array | None, at_target: Array | None, left: float
) -> SharedErrors | OwnErrors:
    half = FLANK_SHARE * whole
    if at_spheres is not None and at_target is not None:
        return _shared("backlash", left * half * np.concatenate([at_spheres, at_target])[:, None, :])
    own = half @ half.transpose(0, 2, 1)
    own[:-1] *= 1.0 if at_spheres is None else left**2
    own[-1] *= 1.0 if at_target is None else left**2
    return OwnErrors("backlash", own[:-1], own[-1])


def _at_rest(spheres: int, servo_mm: float, scatter_mm: float) -> OwnErrors:
    at_target = np.eye(3) * scatter_mm**2
    at_sphere = at_target + np.eye(3) * servo_mm**2 / 3.0
    name = "servo and repeatability" if servo_mm else "repeatability"
    return OwnErrors(name, np.tile(at_sphere, (spheres, 1, 1)), at_target)
