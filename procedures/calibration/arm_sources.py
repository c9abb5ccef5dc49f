"""The errors of an arm as sources of a predicted target error: how each displaces the tool at every pose.

Sizes are those of an uncalibrated arm (parameter set S of the error study) unless others are given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.calibration.arm.parameters import BACKLASH_RAD, SAG_RAD, TOOL_MM
from procedures.calibration.arm_geometry import JOINT_OFFSET_RAD, error_columns
from procedures.registration.target_prediction import OwnErrors, SharedErrors
from ronna_hw.arm.deviations import FLANK_SHARE, gravity_levers
from ronna_hw.arm.links import Chain

Array = NDArray[np.float64]

REPEATABILITY_MM = 0.015  # per axis, at rest
SERVO_MM = 0.03  # 3-D rms of what the servo leaves
PER_JOINT = 11  # columns: offset, four of harmonics, six of the link
HARMONIC_COLUMNS = slice(1, 5)
SAGGING = (1, 2)  # joints, counted from 0


@dataclass(frozen=True)
class ArmPoses:
    """Poses of the arm: joints (p, axes), tool origins (p, 3) mm in the robot frame.

    `sides` (p, axes), -1 or 1, say where in its backlash each joint rests; None where that is not known.
    """

    joints_rad: Array
    points_mm: Array
    sides: Array | None


def arm_sources(
    chain: Chain, spheres: ArmPoses, target: ArmPoses, *, share: float = 1.0
) -> tuple[SharedErrors | OwnErrors, ...]:
    """Geometry, joints, backlash and what does not repeat, for one target and its `n` spheres.

    `share` of the sizes of set S is left in this arm; backlash, which no calibration compensates, and what
    does not repeat are the same in all.
    """
    joints = np.concatenate([spheres.joints_rad, target.joints_rad])
    columns = error_columns(chain, joints, np.concatenate([spheres.points_mm, target.points_mm]))
    by_joint = columns.reshape(*columns.shape[:2], -1, PER_JOINT)
    swings = by_joint[..., 0] / JOINT_OFFSET_RAD  # (p, 3, axes) mm per rad
    geometry = share * np.delete(by_joint, HARMONIC_COLUMNS, axis=3).reshape(len(joints), 3, -1)
    harmonics = share * by_joint[..., HARMONIC_COLUMNS].reshape(len(joints), 3, -1)
    levers = gravity_levers(chain, joints)
    sag = share * SAG_RAD * np.stack([swings[..., one] * levers[:, one, None] for one in SAGGING], axis=-1)
    return (
        _shared("links and joint offsets", geometry),
        _shared("harmonics and sag", np.concatenate([harmonics, sag], axis=2)),
        _backlash(swings, spheres.sides, target.sides),
        _at_rest(len(spheres.joints_rad)),
    )


def tool_frame(at_spheres: Array, at_target: Array, tool_mm: float = TOOL_MM) -> SharedErrors:
    """The tool frame's error on the flange, `tool_mm` per axis: it turns with the tool.

    Rotations robot <- flange at the spheres (n, 3, 3) and at the target (3, 3).
    """
    return SharedErrors("tool frame", tool_mm * at_spheres, tool_mm * at_target)


def ct_errors(covariance_mm2: ArrayLike, source: str = "CT") -> OwnErrors:
    """Errors of the spheres in the CT, (n, 3, 3) mm2 in the frame of the robot."""
    return OwnErrors(source, np.asarray(covariance_mm2, dtype=float), np.zeros((3, 3)))


def _shared(source: str, columns_mm: Array) -> SharedErrors:
    return SharedErrors(source, columns_mm[:-1], columns_mm[-1])


def _backlash(swings: Array, at_spheres: Array | None, at_target: Array | None) -> SharedErrors | OwnErrors:
    half = FLANK_SHARE * BACKLASH_RAD * swings
    if at_spheres is not None and at_target is not None:
        return _shared("backlash", half * np.concatenate([at_spheres, at_target])[:, None, :])
    own = half @ half.transpose(0, 2, 1)
    return OwnErrors("backlash", own[:-1], own[-1])


def _at_rest(spheres: int) -> OwnErrors:
    at_target = np.eye(3) * REPEATABILITY_MM**2
    at_sphere = at_target + np.eye(3) * SERVO_MM**2 / 3.0
    return OwnErrors("servo and repeatability", np.tile(at_sphere, (spheres, 1, 1)), at_target)
