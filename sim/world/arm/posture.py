"""All joint angles of one arm posture in closed form: E6POS with status S and turn T to axes.

The wrist root is where A4, A5 and A6 intersect; A1 to A3 position it, A4 to A6 rotate the flange about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import acos, atan2, cos, degrees, hypot, pi, radians, sin

import numpy as np
from numpy.typing import NDArray

from sim.world.arm.orientation import ABOVE_STRETCH, OVERHEAD, WRIST_NOT_POSITIVE
from sim.world.arm.robot_description import FLANGE_PITCH_DEG, RobotDescription
from sim.world.rigid import rotation_from_vector

Matrix = NDArray[np.float64]
STRAIGHT_WRIST = 1e-6  # sine of A5 below which only A4 + A6 is defined
ZERO_DEG = 0.01  # a frame with four decimals does not show on which side of zero its axes were


def axes_of_posture(
    arm: RobotDescription, flange: Matrix, status: int, turn: int, near_deg: Sequence[float]
) -> list[float] | None:
    """Axes (deg) that bring the flange (4, 4, in $ROBROOT) to a pose in the posture S T.

    None if the pose is out of reach, or an axis of that turn is beyond its end switch. `near_deg` decides A4
    if the wrist is straight.
    """
    angles = axes_of_status(arm, flange, status, radians(near_deg[3]))
    if angles is None:
        return None
    axes = []
    for number, (joint, angle) in enumerate(zip(arm.joints, angles, strict=True)):
        value = _turned((degrees(angle) + 180.0) % 360.0 - 180.0, bool(turn & 1 << number))
        if not joint.lower_deg <= value <= joint.upper_deg:
            return None
        axes.append(value)
    return axes


def axes_of_status(
    arm: RobotDescription, flange: Matrix, status: int, near_A4: float = 0.0
) -> tuple[float, float, float, float, float, float] | None:
    """Axes (rad, up to whole turns) that bring the flange (4, 4, in $ROBROOT) to a pose with status S.

    None if the pose is out of reach; end switches are not checked. `near_A4` decides A4 if
    the wrist is straight.
    """
    joints = arm.joints
    rotation = flange[:3, :3] @ rotation_from_vector((0.0, -radians(FLANGE_PITCH_DEG), 0.0))
    x, y, z = (flange[:3, 3] - joints[5].origin_mm[0] * rotation[:, 0]).tolist()
    overhead = bool(status & OVERHEAD)
    A1 = -atan2(y, x) + (pi if overhead else 0.0)
    out_mm = (-hypot(x, y) if overhead else hypot(x, y)) - joints[1].origin_mm[0]
    down_mm = joints[0].origin_mm[2] - z
    upper_mm = joints[2].origin_mm[0]
    fore_mm = hypot(joints[4].origin_mm[0], joints[3].origin_mm[2])
    cosine = (out_mm**2 + down_mm**2 - upper_mm**2 - fore_mm**2) / (2.0 * upper_mm * fore_mm)
    if abs(cosine) > 1.0:
        return None
    bend = acos(cosine) if status & ABOVE_STRETCH else -acos(cosine)
    A3 = radians(arm.stretched_A3_deg) + bend
    A2 = atan2(down_mm, out_mm) - atan2(fore_mm * sin(bend), upper_mm + fore_mm * cos(bend))
    wrist = _about_z(-A1).T @ rotation
    wrist = rotation_from_vector((0.0, -(A2 + A3), 0.0)) @ wrist
    A4, A5, A6 = _wrist(wrist, bool(status & WRIST_NOT_POSITIVE), near_A4)
    return A1, A2, A3, A4, A5, A6


def _wrist(wrist: Matrix, not_positive: bool, near_A4: float) -> tuple[float, float, float]:
    """A4, A5, A6 (rad) of a rotation Rx(-A4) Ry(A5) Rx(-A6)."""
    sine = hypot(wrist[1, 0], wrist[2, 0])
    if sine < STRAIGHT_WRIST:
        both = atan2(-wrist[2, 1], wrist[1, 1])
        return near_A4, 0.0, both - near_A4
    sign = -1.0 if not_positive else 1.0
    A4 = atan2(-sign * wrist[1, 0], -sign * wrist[2, 0])
    A6 = atan2(-sign * wrist[0, 1], sign * wrist[0, 2])
    return A4, sign * atan2(sine, wrist[0, 0]), A6


def _turned(angle_deg: float, negative: bool) -> float:
    """The same direction with the sign required by the turn; at zero both signs are equal."""
    if abs(angle_deg) < ZERO_DEG:
        return angle_deg
    if negative and angle_deg >= 0.0:
        return angle_deg - 360.0
    if not negative and angle_deg < 0.0:
        return angle_deg + 360.0
    return angle_deg


def _about_z(angle: float) -> Matrix:
    return rotation_from_vector((0.0, 0.0, angle))
