"""The KR 6 R900 as an arm's `Kinematics`."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, hypot, sin
from typing import TYPE_CHECKING

from ronna_hw.arm.kinematics import Branch, Segment, SingularMeasure, Solution
from ronna_hw.arm.kr6_r900 import geometry, inverse
from ronna_hw.arm.kr6_r900.geometry import DIMENSIONS, ArmVariant, Dimensions
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

AXIS_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)


class Kr6R900:
    """A variant of the arm. Its branches are KUKA's status S."""

    axis_names = AXIS_NAMES
    home_rad = HOME_RAD
    branches = inverse.BRANCHES

    def __init__(self, dimensions: Dimensions) -> None:
        self.dimensions = dimensions
        self.name = str(dimensions.variant)
        self.lower_rad = dimensions.lower_rad
        self.upper_rad = dimensions.upper_rad
        self.full_speed_rad_s = dimensions.full_speed_rad_s
        self.acceleration_rad_s2 = dimensions.acceleration_rad_s2
        self.chain = geometry.chain(dimensions)
        self.links = geometry.links(dimensions)
        self.column_height_mm = dimensions.base_height_mm

    def forward(self, joints_rad: JointVector) -> Pose:
        return geometry.forward(self.dimensions, joints_rad)

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        return geometry.forward(self.dimensions, joints_rad).to_transform()

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        return geometry.jacobian(self.dimensions, joints_rad)

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        return inverse.solutions(self.dimensions, pose)

    def branch_of(self, joints_rad: JointVector) -> Branch:
        return inverse.branch_of(self.dimensions, joints_rad)

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        return inverse.solve_branch(self.dimensions, pose, branch, near)

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        """`wrist` is |sin A5|, `elbow` the sine of the bend from upper arm to the line to the wrist centre.

        `shoulder` is the distance of the wrist centre from the axis of A1 as a share of the reach.
        """
        arm = self.dimensions
        _, A2, A3, _, A5, _ = joints_rad
        ahead_mm = (
            arm.shoulder_offset_mm
            + arm.upper_arm_mm * cos(A2)
            + hypot(arm.forearm_mm, arm.elbow_offset_mm) * cos(A2 + A3 - arm.stretched_A3_rad)
        )
        return SingularMeasure(
            abs(sin(A5)), abs(sin(A3 - arm.stretched_A3_rad)), abs(ahead_mm) / arm.reach_mm
        )

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        """|A5|, which is below half a turn."""
        return abs(joints_rad[4])

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        """A4."""
        return joints_rad[3]

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        return geometry.link_segments(self.dimensions, joints_rad)

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        return geometry.levers_mm(self.dimensions, tool_points_mm)


_ARMS = {variant: Kr6R900(dimensions) for variant, dimensions in DIMENSIONS.items()}


def kr6_r900(variant: ArmVariant | str = ArmVariant.SIXX) -> Kr6R900:
    """The arm of a variant; an unknown name raises ValueError."""
    return _ARMS[ArmVariant(variant)]
