"""KUKA's orientation angles, and status and turn of an arm posture."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, degrees, radians, sin

import numpy as np
from numpy.typing import NDArray

from sim.world.arm.robot_description import RobotDescription

Matrix = NDArray[np.float64]
GIMBAL_LIMIT = 1e-9  # cosine of B below which only A - C or A + C is defined
OVERHEAD, ABOVE_STRETCH, WRIST_NOT_POSITIVE = 1, 2, 4  # bits of the status


def frame_of(pose: Matrix) -> list[float]:
    """X Y Z (mm) A B C (deg) of a pose (4, 4); R = Rz(A) Ry(B) Rx(C). At B = 90 deg, A is set to 0."""
    r00, _, _, x, r10, r11, r12, y, r20, r21, r22, z = pose[:3].ravel().tolist()
    cosine_B = (r00 * r00 + r10 * r10) ** 0.5
    if cosine_B < GIMBAL_LIMIT:
        B = 90.0 if r20 < 0 else -90.0
        # With A = 0 the second column is (0, cos C, -sin C) in the rotated frame.
        return [x, y, z, 0.0, B, degrees(atan2(-r12, r11)) + 0.0]
    return [
        x,
        y,
        z,
        degrees(atan2(r10, r00)),
        degrees(atan2(-r20, cosine_B)),
        degrees(atan2(r21, r22)),
    ]


def pose_of_frame(frame: Sequence[float]) -> Matrix:
    """Pose (4, 4) of X Y Z (mm) A B C (deg)."""
    x, y, z, A, B, C = frame
    ca, sa = cos(radians(A)), sin(radians(A))
    cb, sb = cos(radians(B)), sin(radians(B))
    cc, sc = cos(radians(C)), sin(radians(C))
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc, x],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc, y],
            [-sb, cb * sc, cb * cc, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def status_and_turn(arm: RobotDescription, axes_deg: Sequence[float]) -> tuple[int, int]:
    """S and T of E6POS. Bits of S: wrist root behind A1, A3 beyond the stretched arm, A5 not positive."""
    A2, A3, A5 = axes_deg[1], axes_deg[2], axes_deg[4]
    shoulder_mm = arm.joints[1].origin_mm[0]
    upper_mm = arm.joints[2].origin_mm[0]
    elbow_mm = arm.joints[3].origin_mm[2]
    forearm_mm = arm.joints[4].origin_mm[0]
    fore = radians(A2 + A3)
    ahead_mm = shoulder_mm + upper_mm * cos(radians(A2)) + forearm_mm * cos(fore) + elbow_mm * sin(fore)
    status = OVERHEAD if ahead_mm < 0 else 0
    if arm.stretched_A3_deg <= A3:
        status |= ABOVE_STRETCH
    if A5 <= 0:
        status |= WRIST_NOT_POSITIVE
    turn = sum(1 << number for number, angle in enumerate(axes_deg) if angle < 0)
    return status, turn
