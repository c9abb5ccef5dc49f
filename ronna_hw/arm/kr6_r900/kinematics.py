"""Closed-form `Kinematics` of the KR 6 R900; places of bodies are written out for the real-time loop."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin
from typing import TYPE_CHECKING

from ronna_hw.arm.kinematics import (
    COLUMN_NAME,
    ArmPart,
    Branch,
    Chain,
    Joint,
    Link,
    Segment,
    SingularMeasure,
    Solution,
    require_off_base,
)
from ronna_hw.arm.kr6_r900 import inverse
from ronna_hw.arm.kr6_r900.geometry import DIMENSIONS, RADII, SIXX, Kr6Dimensions
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

AXIS_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
FOREARM_SHARE = 0.65  # of the distance from elbow to wrist centre: drives behind, slim wrist in front
UPPER_ARM, FOREARM, WRIST, HAND = "upper arm", "forearm", "wrist", "hand"
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
MINUS_X, MINUS_Z = (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)
ORIGIN: Vector3 = (0.0, 0.0, 0.0)


class Kr6R900:
    """Kinematics of one KR 6 R900 variant. Branches are numbered like KUKA's status S."""

    axis_names = AXIS_NAMES
    home_rad = HOME_RAD
    branches = inverse.BRANCHES
    radii = RADII

    def __init__(self, dimensions: Kr6Dimensions) -> None:
        self.dimensions = dimensions
        self.name = dimensions.name
        self.lower_rad = dimensions.lower_rad
        self.upper_rad = dimensions.upper_rad
        self.full_speed_rad_s = dimensions.full_speed_rad_s
        self.acceleration_rad_s2 = dimensions.acceleration_rad_s2
        self.chain = _chain(dimensions)
        self.links = _links(dimensions)
        self.column_height_mm = dimensions.base_height_mm

    def forward(self, joints_rad: JointVector) -> Pose:
        """Return the flange pose in $ROBROOT; z points out of the flange.

        The chain is Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6) Ry(90 deg), multiplied out.
        """
        arm = self.dimensions
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
            arm.shoulder_offset_mm
            + arm.upper_arm_mm * cos(A2)
            + arm.forearm_mm * c23
            + arm.elbow_offset_mm * s23
        )
        up_mm = (
            arm.base_height_mm - arm.upper_arm_mm * sin(A2) - arm.forearm_mm * s23 + arm.elbow_offset_mm * c23
        )
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

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        return self.forward(joints_rad).to_transform()

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        import numpy as np  # for planning only: the real-time process goes without

        arm = self.dimensions
        A1, A2, A3, A4, _, _ = joints_rad
        c1, s1 = cos(A1), sin(A1)
        c23, s23 = cos(A2 + A3), sin(A2 + A3)
        flange = self.forward(joints_rad)
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

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        require_off_base(pose)
        return inverse.solutions(self.dimensions, pose)

    def branch_of(self, joints_rad: JointVector) -> Branch:
        return inverse.branch_of(self.dimensions, joints_rad)

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        return inverse.solve_branch(self.dimensions, pose, branch, near)

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        """Return the distances from singularity.

        `wrist` is |sin A5|, `elbow` the sine of the bend between upper arm and the line to the wrist centre.

        `shoulder` is the distance of the wrist centre from the axis of A1 as a share of the reach.
        """
        arm = self.dimensions
        _, A2, A3, _, A5, _ = joints_rad
        shoulder = abs(arm.wrist_ahead_mm(A2, A3)) / arm.reach_mm
        return SingularMeasure(abs(sin(A5)), abs(sin(A3 - arm.stretched_A3_rad)), shoulder)

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        """Return |A5|, always less than half a turn."""
        return abs(joints_rad[4])

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        """Return A4."""
        return joints_rad[3]

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        arm = self.dimensions
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
        flange = self.forward(joints_rad)
        wrist = flange.apply((0.0, 0.0, -arm.flange_mm))
        return [(shoulder, elbow), (beside, slim), (slim, wrist), (wrist, flange.position_mm)], flange

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        arm = self.dimensions
        about_wrist = max((hypot(x, y, z + arm.flange_mm) for x, y, z in tool_points_mm), default=0.0)
        about_wrist = max(about_wrist, arm.flange_mm)
        about_A6 = max((hypot(x, y) for x, y, _ in tool_points_mm), default=0.0)
        about_A3 = about_wrist + arm.elbow_to_wrist_mm
        about_A2 = about_A3 + arm.upper_arm_mm
        return (about_A2 + arm.shoulder_offset_mm, about_A2, about_A3, about_wrist, about_wrist, about_A6)


def _combine(u: Vector3, a: float, v: Vector3, b: float) -> Vector3:
    return (a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2])


def _chain(arm: Kr6Dimensions) -> Chain:
    """Build the chain Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6) Ry(90 deg)."""
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


def _links(arm: Kr6Dimensions) -> tuple[Link, ...]:
    """Build the links: upper arm, forearm with drives, slim wrist, and hand from wrist centre to flange."""
    slim = (FOREARM_SHARE * arm.forearm_mm, 0.0, 0.0)
    return (
        Link(UPPER_ARM, ArmPart.UPPER_ARM, 1, ORIGIN, (arm.upper_arm_mm, 0.0, 0.0), (COLUMN_NAME,)),
        Link(FOREARM, ArmPart.FOREARM, 3, ORIGIN, slim, (UPPER_ARM,)),
        Link(WRIST, ArmPart.WRIST, 3, slim, (arm.forearm_mm, 0.0, 0.0), (FOREARM,)),
        Link(HAND, ArmPart.HAND, 4, ORIGIN, (arm.flange_mm, 0.0, 0.0), (FOREARM, WRIST)),
    )


_ARMS = {name: Kr6R900(dimensions) for name, dimensions in DIMENSIONS.items()}


def kr6_r900(variant: str = SIXX) -> Kr6R900:
    """Return the arm model of a variant; raises KeyError for an unknown name."""
    return _ARMS[variant]
