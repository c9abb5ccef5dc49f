"""An arm with seven axes, for what must not count them: a KR 6 on a boom that turns about its base."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin
from typing import TYPE_CHECKING

import numpy as np

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
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector, Vector3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ronna_hw.frames import Transform

KR6 = kr6_r900()
BOOM, BOOM_MM = "boom", 150.0


class SevenAxisArm:
    """Its inverse leaves the boom where it is, as a redundant arm must choose one of its postures."""

    name = "seven_axes"
    axis_names = ("E1", *KR6.axis_names)
    home_rad: JointVector = (0.0, *KR6.home_rad)
    branches = KR6.branches
    lower_rad: JointVector = (-pi / 2, *KR6.lower_rad)
    upper_rad: JointVector = (pi / 2, *KR6.upper_rad)
    full_speed_rad_s: JointVector = (2.0, *KR6.full_speed_rad_s)
    acceleration_rad_s2: JointVector = (6.0, *KR6.acceleration_rad_s2)
    radii = KR6.radii
    column_height_mm = KR6.column_height_mm
    chain = Chain(
        KR6.chain.base_mm,
        (Joint((0.0, 0.0, 1.0), (BOOM_MM, 0.0, 0.0)), *KR6.chain.joints),
        KR6.chain.flange_rotation,
    )
    links = (
        Link(BOOM, ArmPart.UPPER_ARM, 0, (0.0, 0.0, 0.0), (BOOM_MM, 0.0, 0.0), (COLUMN_NAME,)),
        *(
            link._replace(
                joint=link.joint + 1, touches=(*link.touches, BOOM) if number == 0 else link.touches
            )
            for number, link in enumerate(KR6.links)
        ),
    )

    def forward(self, joints_rad: JointVector) -> Pose:
        return _boom_end(joints_rad[0]).compose(KR6.forward(joints_rad[1:]))

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        return self.forward(joints_rad).to_transform()

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        turn = np.reshape(_boom_end(joints_rad[0]).rotation, (3, 3))
        x, y, _ = self.forward(joints_rad).position_mm
        others = np.kron(np.eye(2), turn) @ KR6.jacobian(joints_rad[1:])
        return np.column_stack([(-y, x, 0.0, 0.0, 0.0, 1.0), others])

    def solutions(self, pose: Pose) -> tuple[Solution, ...]:
        require_off_base(pose)
        found = KR6.solutions(_boom_end(0.0).inverse().compose(pose))
        return tuple(Solution(branch, (0.0, *joints_rad)) for branch, joints_rad in found)

    def branch_of(self, joints_rad: JointVector) -> Branch:
        return KR6.branch_of(joints_rad[1:])

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        boom_rad = near[0]
        from_boom = _boom_end(boom_rad).inverse().compose(pose)
        return (boom_rad, *KR6.solve_branch(from_boom, branch, near[1:]))

    def singular_measure(self, joints_rad: JointVector) -> SingularMeasure:
        return KR6.singular_measure(joints_rad[1:])

    def wrist_bend_rad(self, joints_rad: JointVector) -> float:
        return KR6.wrist_bend_rad(joints_rad[1:])

    def wrist_turn_rad(self, joints_rad: JointVector) -> float:
        return KR6.wrist_turn_rad(joints_rad[1:])

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        boom = _boom_end(joints_rad[0])
        segments, flange = KR6.link_segments(joints_rad[1:])
        moved: list[Segment] = [(boom.apply(start), boom.apply(end)) for start, end in segments]
        height_mm = KR6.column_height_mm
        return [((0.0, 0.0, height_mm), boom.apply((0.0, 0.0, height_mm))), *moved], boom.compose(flange)

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        others = KR6.levers_mm(tool_points_mm)
        return (BOOM_MM + others[0], *others)


def _boom_end(boom_rad: float) -> Pose:
    """Return the place of the KR 6 on the boom, at the height of the base."""
    c, s = cos(boom_rad), sin(boom_rad)
    return Pose((BOOM_MM * c, BOOM_MM * s, 0.0), (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0))
