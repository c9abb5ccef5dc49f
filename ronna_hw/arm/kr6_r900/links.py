"""Chain and link bodies of the KR 6 R900, and the bodies' positions, written out for the real-time loop."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin

from ronna_hw.arm.kr6_r900.dimensions import Dimensions
from ronna_hw.arm.kr6_r900.forward import forward
from ronna_hw.arm.links import COLUMN_NAME, ArmPart, Chain, Joint, Link, Segment
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector, Vector3

FOREARM_SHARE = 0.65  # of the distance from elbow to wrist centre: drives behind, slim wrist in front
UPPER_ARM, FOREARM, WRIST, HAND = "upper arm", "forearm", "wrist", "hand"
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MINUS_X, MINUS_Z = (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
ORIGIN: Vector3 = (0.0, 0.0, 0.0)


def chain(arm: Dimensions) -> Chain:
    """Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6) Ry(90 deg)."""
    return Chain(
        base_mm=(0.0, 0.0, arm.base_height_mm),
        joints=(
            Joint(MINUS_Z, (arm.shoulder_offset_mm, 0.0, 0.0)),
            Joint(Y, (arm.upper_arm_mm, 0.0, 0.0)),
            Joint(Y, (0.0, 0.0, arm.elbow_offset_mm)),
            Joint(MINUS_X, (arm.forearm_mm, 0.0, 0.0)),
            Joint(Y, (arm.flange_mm, 0.0, 0.0)),
            Joint(MINUS_X, ORIGIN),
        ),
        flange_rotation=(0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0),
    )


def links(arm: Dimensions) -> tuple[Link, ...]:
    """Upper arm, forearm with its drives, slim wrist, and the hand between wrist centre and flange."""
    slim = (FOREARM_SHARE * arm.forearm_mm, 0.0, 0.0)
    return (
        Link(UPPER_ARM, ArmPart.UPPER_ARM, 1, ORIGIN, (arm.upper_arm_mm, 0.0, 0.0), (COLUMN_NAME,)),
        Link(FOREARM, ArmPart.FOREARM, 3, ORIGIN, slim, (UPPER_ARM,)),
        Link(WRIST, ArmPart.WRIST, 3, slim, (arm.forearm_mm, 0.0, 0.0), (FOREARM,)),
        Link(HAND, ArmPart.HAND, 4, ORIGIN, (arm.flange_mm, 0.0, 0.0), (FOREARM, WRIST)),
    )


def link_segments(arm: Dimensions, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
    """Axes of the links in $ROBROOT, and the flange's pose."""
    A1, A2, A3, _, _, _ = joints_rad
    c1, s1, s2 = cos(A1), sin(A1), sin(A2)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    height, near, across = arm.base_height_mm, arm.shoulder_offset_mm, arm.elbow_offset_mm
    out = near + arm.upper_arm_mm * cos(A2)
    up = height - arm.upper_arm_mm * s2
    shoulder = (c1 * near, -s1 * near, height)
    elbow = (c1 * out, -s1 * out, up)
    beside_out, beside_up = out + across * s23, up + across * c23
    beside = (c1 * beside_out, -s1 * beside_out, beside_up)
    along = FOREARM_SHARE * arm.forearm_mm
    slim_out, slim_up = beside_out + along * c23, beside_up - along * s23
    slim = (c1 * slim_out, -s1 * slim_out, slim_up)
    flange = forward(arm, joints_rad)
    wrist = flange.apply((0.0, 0.0, -arm.flange_mm))
    return [(shoulder, elbow), (beside, slim), (slim, wrist), (wrist, flange.position_mm)], flange


def levers_mm(arm: Dimensions, tool_points_mm: Sequence[Vector3]) -> JointVector:
    """Bound on the motion of any point of links and tool (flange frame), per radian of each axis."""
    about_wrist = max((hypot(x, y, z + arm.flange_mm) for x, y, z in tool_points_mm), default=0.0)
    about_wrist = max(about_wrist, arm.flange_mm)
    about_A6 = max((hypot(x, y) for x, y, _ in tool_points_mm), default=0.0)
    about_A3 = about_wrist + arm.elbow_to_wrist_mm
    about_A2 = about_A3 + arm.upper_arm_mm
    return (about_A2 + arm.shoulder_offset_mm, about_A2, about_A3, about_wrist, about_wrist, about_A6)
