"""Contributions of the arm to a predicted target error, from the tool displacement at every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.error_sources import (
    BACKLASH,
    CT,
    HARMONICS,
    IDENTIFIED,
    LINKS,
    REPEATABILITY,
    SERVO,
    TOOL_FRAME,
)
from procedures.registration.target_prediction import AllowedErrors, IndependentErrors, SharedErrors
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import FLANK_SHARE, flange_rotations
from ronna_hw.calibrated_arm.error_budget import (
    BACKLASH_RAD,
    SAGGING,
    UNCALIBRATED,
    ErrorSizes,
    IdentifiedArm,
    by_deviation,
    displacements,
)

REPEATABILITY_MM = 0.015  # per axis, at rest
SERVO_MM = 0.03  # 3-D rms of the servo's residual


@dataclass(frozen=True)
class ArmPoses:
    """Arm poses: joints (p, axes), tool origins (p, 3) mm in the robot frame.

    `sides` (p, axes), -1 or 1, give the side of its backlash on which each joint rests; 0 if unknown, None if
    all are.
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
) -> tuple[SharedErrors | IndependentErrors, ...]:
    """List the error sources for a target and its `n` spheres.

    All arms that are not identified have one repeatability. `servo_mm` is 0 if the servo's residual is
    measured.
    """
    joints = np.concatenate([spheres.joints_rad, target.joints_rad])
    points = np.concatenate([spheres.points_mm, target.points_mm])
    sides = np.concatenate(
        [np.zeros_like(one.joints_rad) if one.sides is None else one.sides for one in (spheres, target)]
    )
    shifts, arm = displacements(chain, joints, points, sizes), sizes.identified
    if arm is not None:
        columns = by_deviation(chain, joints, points, sides)
        return (
            _shared_errors(IDENTIFIED, columns @ arm.remaining),
            *_backlash(shifts.swings_mm * arm.backlash_rad, sides, 0.0),
            _repeatability_errors(len(spheres.joints_rad), servo_mm, arm.scatter_mm),
        )
    return (
        _shared_errors(LINKS, shifts.links_mm),
        _shared_errors(HARMONICS, _sum_sag(shifts.joints_mm)),
        *_backlash(BACKLASH_RAD * shifts.swings_mm, sides, sizes.backlash),
        _repeatability_errors(len(spheres.joints_rad), servo_mm, REPEATABILITY_MM),
        # It turns with the flange; the same in all directions.
        _shared_errors(TOOL_FRAME, sizes.tool_mm * flange_rotations(chain, joints)),
    )


def identified_errors(chain: Chain, spheres: ArmPoses, arm: IdentifiedArm) -> AllowedErrors:
    """Return the errors of an identified arm at the spheres, known sides of its backlash included."""
    sides = np.zeros_like(spheres.joints_rad) if spheres.sides is None else spheres.sides
    columns = by_deviation(chain, spheres.joints_rad, spheres.points_mm, sides)
    scatter_mm2 = np.tile(np.eye(3) * arm.scatter_mm**2, (len(columns), 1, 1))
    return AllowedErrors(scatter_mm2, columns @ arm.remaining, arm.freedom)


def ct_errors(covariance_mm2: ArrayLike) -> IndependentErrors:
    """Return the spheres' CT errors as independent errors, (n, 3, 3) mm2 in the robot frame."""
    return IndependentErrors(CT, np.asarray(covariance_mm2, dtype=float), np.zeros((3, 3)))


def _sum_sag(joints_mm: Array) -> Array:
    """Sum the sag of all joints: unlike independent errors, gravity bends them all the same way."""
    harmonics, sag = np.split(joints_mm, [-len(SAGGING)], axis=2)
    return np.concatenate([harmonics, sag.sum(axis=2, keepdims=True)], axis=2)


def _shared_errors(source: str, columns_mm: Array) -> SharedErrors:
    return SharedErrors(source, columns_mm[:-1], columns_mm[-1])


def _backlash(
    full_mm: Array, sides: Array, remaining_share: float
) -> tuple[SharedErrors | IndependentErrors, ...]:
    """Return what remains of a backlash (p, 3, axes) mm on known sides, and all of it on unknown ones."""
    half = FLANK_SHARE * full_mm
    known = _shared_errors(BACKLASH, remaining_share * half * sides[:, None, :])
    unknown = half * (sides == 0.0)[:, None, :]
    own = unknown @ unknown.transpose(0, 2, 1)
    apart = IndependentErrors(BACKLASH, own[:-1], own[-1])
    return (*([known] if sides.any() and remaining_share else []), *([apart] if own.any() else []))


def _repeatability_errors(spheres: int, servo_mm: float, scatter_mm: float) -> IndependentErrors:
    at_target = np.eye(3) * scatter_mm**2
    at_sphere = at_target + np.eye(3) * servo_mm**2 / 3.0
    name = SERVO if servo_mm else REPEATABILITY
    return IndependentErrors(name, np.tile(at_sphere, (spheres, 1, 1)), at_target)
