"""Geometry of the KR 6 R900 in its two variants: dimensions, forward kinematics, Jacobian, link bodies.

All of it is in closed form; the positions of the bodies are written out for the real-time loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from math import cos, hypot, sin
from typing import TYPE_CHECKING

from ronna_hw.arm.kinematics import COLUMN_NAME, ArmPart, Chain, Joint, Link, Segment
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class ArmVariant(StrEnum):
    """Two arms with the name KR 6 R900; they differ by 10 mm at the elbow and at the flange."""

    SIXX = "kr6_r900_sixx"
    R900_2 = "kr6_r900_2"


@dataclass(frozen=True)
class Dimensions:
    """Dimensions of a variant; names follow the chain from $ROBROOT to the flange.

    A1 turns about -z, A2, A3, A5 about +y, A4, A6 about -x. With all axes at zero the arm extends along x.
    """

    variant: ArmVariant
    base_height_mm: float  # $ROBROOT to A2, along z
    shoulder_offset_mm: float  # A1 to A2, along x
    upper_arm_mm: float  # A2 to A3
    elbow_offset_mm: float  # A3 to the axis of A4, perpendicular
    forearm_mm: float  # A3 to the wrist centre, along A4
    flange_mm: float  # wrist centre to flange, along A6
    lower_rad: JointVector
    upper_rad: JointVector
    full_speed_rad_s: JointVector
    acceleration_rad_s2: JointVector

    @cached_property
    def elbow_to_wrist_mm(self) -> float:
        """Straight distance from A3 to the wrist centre."""
        return math.hypot(self.forearm_mm, self.elbow_offset_mm)

    @cached_property
    def stretched_A3_rad(self) -> float:
        """Angle of A3 at which upper arm and wrist centre are aligned."""
        return math.atan2(self.elbow_offset_mm, self.forearm_mm)

    @cached_property
    def reach_mm(self) -> float:
        """Largest distance of the wrist centre from the axis of A1, at the height of A2."""
        return self.shoulder_offset_mm + self.upper_arm_mm + self.elbow_to_wrist_mm


# Geometry and ranges: public robot descriptions of both arms. Accelerations: planner limits published for the
# sixx; none are published for the -2, which is no weaker, so the same are used.
_LOWER = radians6(-170, -190, -120, -185, -120, -350)
_UPPER = radians6(170, 45, 156, 185, 120, 350)
_ACCELERATION: JointVector = (21.67, 6.89, 31.42, 133.1, 135.6, 268.4)

DIMENSIONS = {
    ArmVariant.SIXX: Dimensions(
        variant=ArmVariant.SIXX,
        base_height_mm=400.0,
        shoulder_offset_mm=25.0,
        upper_arm_mm=455.0,
        elbow_offset_mm=35.0,
        forearm_mm=420.0,
        flange_mm=80.0,
        lower_rad=_LOWER,
        upper_rad=_UPPER,
        full_speed_rad_s=radians6(360, 300, 360, 381, 388, 615),
        acceleration_rad_s2=_ACCELERATION,
    ),
    ArmVariant.R900_2: Dimensions(
        variant=ArmVariant.R900_2,
        base_height_mm=400.0,
        shoulder_offset_mm=25.0,
        upper_arm_mm=455.0,
        elbow_offset_mm=25.0,
        forearm_mm=420.0,
        flange_mm=90.0,
        lower_rad=_LOWER,
        upper_rad=_UPPER,
        full_speed_rad_s=radians6(360, 300, 360, 450, 450, 540),
        acceleration_rad_s2=_ACCELERATION,
    ),
}


def forward(arm: Dimensions, joints_rad: JointVector) -> Pose:
    """Pose of the flange in $ROBROOT; z points out of the flange.

    The chain is Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6) Ry(90 deg), multiplied out.
    """
    A1, A2, A3, A4, A5, A6 = joints_rad
    c1, s1 = cos(A1), sin(A1)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    c4, s4 = cos(A4), sin(A4)
    c5, s5 = cos(A5), sin(A5)
    c6, s6 = cos(A6), sin(A6)
    # Columns of the flange frame in the frame of the forearm (x along A4, y along A3, z across).
    x0, x1, x2 = -s5 * c6, -c4 * s6 - s4 * c5 * c6, s4 * s6 - c4 * c5 * c6
    y0, y1, y2 = -s5 * s6, c4 * c6 - s4 * c5 * s6, -s4 * c6 - c4 * c5 * s6
    z0, z1, z2 = c5, -s4 * s5, -c4 * s5
    # Rows of the forearm frame in $ROBROOT.
    r00, r01, r02 = c1 * c23, s1, c1 * s23
    r10, r11, r12 = -s1 * c23, c1, -s1 * s23
    r20, r22 = -s23, c23
    forward_mm = (
        arm.shoulder_offset_mm + arm.upper_arm_mm * cos(A2) + arm.forearm_mm * c23 + arm.elbow_offset_mm * s23
    )
    up_mm = arm.base_height_mm - arm.upper_arm_mm * sin(A2) - arm.forearm_mm * s23 + arm.elbow_offset_mm * c23
    az = r00 * z0 + r01 * z1 + r02 * z2
    bz = r10 * z0 + r11 * z1 + r12 * z2
    cz = r20 * z0 + r22 * z2
    hand = arm.flange_mm
    return Pose(
        (c1 * forward_mm + hand * az, -s1 * forward_mm + hand * bz, up_mm + hand * cz),
        (
            r00 * x0 + r01 * x1 + r02 * x2,
            r00 * y0 + r01 * y1 + r02 * y2,
            az,
            r10 * x0 + r11 * x1 + r12 * x2,
            r10 * y0 + r11 * y1 + r12 * y2,
            bz,
            r20 * x0 + r22 * x2,
            r20 * y0 + r22 * y2,
            cz,
        ),
    )


def jacobian(arm: Dimensions, joints_rad: JointVector) -> NDArray[np.float64]:
    """Geometric Jacobian of the flange in $ROBROOT, (6, 6): rows vx vy vz in mm, wx wy wz in rad, per rad."""
    import numpy as np  # for planning only: the real-time process goes without

    A1, A2, A3, A4, _, _ = joints_rad
    c1, s1 = cos(A1), sin(A1)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    flange = forward(arm, joints_rad)
    along = (c1 * c23, -s1 * c23, -s23)
    sideways = (s1, c1, 0.0)
    across = (c1 * s23, -s1 * s23, c23)
    wrist_axis = _combine(across, -sin(A4), sideways, cos(A4))
    flange_axis = (flange.rotation[2], flange.rotation[5], flange.rotation[8])
    shoulder = (c1 * arm.shoulder_offset_mm, -s1 * arm.shoulder_offset_mm, arm.base_height_mm)
    upper = (c1 * cos(A2), -s1 * cos(A2), -sin(A2))
    elbow = _combine(upper, arm.upper_arm_mm, shoulder, 1.0)
    wrist = _combine(flange_axis, -arm.flange_mm, flange.position_mm, 1.0)
    chain: tuple[tuple[Vector3, Vector3], ...] = (
        ((0.0, 0.0, -1.0), (0.0, 0.0, arm.base_height_mm)),
        (sideways, shoulder),
        (sideways, elbow),
        (_combine(along, -1.0, along, 0.0), wrist),
        (wrist_axis, wrist),
        (_combine(flange_axis, -1.0, flange_axis, 0.0), wrist),
    )
    result = np.empty((6, 6))
    p = flange.position_mm
    for column, (axis, origin) in enumerate(chain):
        x, y, z = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
        a, b, c = axis
        result[:, column] = (b * z - c * y, c * x - a * z, a * y - b * x, a, b, c)
    return result


def _combine(u: Vector3, a: float, v: Vector3, b: float) -> Vector3:
    return (a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2])


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
