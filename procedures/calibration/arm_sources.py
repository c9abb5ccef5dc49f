"""An arm's errors as sources of a predicted target error: how each displaces the tool at every pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.target_prediction import OwnErrors, SharedErrors
from ronna_hw.arm.kinematics import Chain
from ronna_hw.calibrated_arm.deviations import FLANK_SHARE, flange_rotations
from ronna_hw.calibrated_arm.error_budget import (
    BACKLASH_RAD,
    SAGGING,
    UNCALIBRATED,
    ErrorSizes,
    by_deviation,
    displacements,
)

Array = NDArray[np.float64]

REPEATABILITY_MM = 0.015  # per axis, at rest
SERVO_MM = 0.03  # 3-D rms of the servo's residual


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
    """List the error sources for one target and its `n` spheres.

    All arms that are not identified have one repeatability. `servo_mm` is 0 if the servo's residual is
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


def ct_errors(covariance_mm2: ArrayLike, source: str = "CT") -> OwnErrors:
    """Errors of the spheres in the CT, (n, 3, 3) mm2 in the robot frame."""
    return OwnErrors(source, np.asarray(covariance_mm2, dtype=float), np.zeros((3, 3)))


def _sag_added(joints_mm: Array) -> Array:
    """Add the sag of all joints up: weight bends them the same way, unlike independent errors."""
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
