"""Joint angles for one pose: branch, whole turns, and the straight line that leads there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from procedures.strategies.strategy import APPROACH_RAD
from ronna_hw.arm.kinematics import Branch, Kinematics, Solution
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform


@dataclass(frozen=True)
class Posture:
    """Joint angles at the approach point, and the straight line of the tool from there to the pose."""

    approach_rad: JointVector
    line: MotionPlan

    @property
    def at_rad(self) -> JointVector:
        """Joint angles at the pose."""
        return self.line.target_rad


def ranked_branches(
    kinematics: Kinematics, flanges: Sequence[Transform], start_rad: JointVector
) -> tuple[Branch, ...]:
    """All branches, the one that reaches most of the flange poses first; the start's own wins a tie.

    Among others that reach equally many, the one whose joints stay closest to the start comes first.
    """
    own = kinematics.branch_of(start_rad)
    served = dict.fromkeys(kinematics.branches, 0)
    travel = dict.fromkeys(kinematics.branches, 0.0)
    for flange in flanges:
        nearest: dict[Branch, float] = {}
        for solution in _solutions(kinematics, flange):
            distance = math.dist(solution.joints_rad, start_rad)
            nearest[solution.branch] = min(distance, nearest.get(solution.branch, math.inf))
        for branch, distance in nearest.items():
            served[branch] += 1
            travel[branch] += distance
    return tuple(sorted(kinematics.branches, key=lambda one: (-served[one], one != own, travel[one])))


def place(
    kinematics: Kinematics,
    approach: Transform,
    pose: Transform,
    flange_from_tool: Transform,
    branch: Branch,
    near_rad: JointVector,
    limits: MotionLimits,
) -> Posture:
    """Joint angles in `branch` at both ends of the approach line, choosing turns nearest to `near_rad`.

    Poses are ROBOT <- TOOL. Raises ARM-001 to ARM-005 when an end or a point of the line is not drivable
    within the arm's limits, or leaves no room for the joints to stand back before they settle there.
    """
    limits = replace(limits, range_margin_rad=limits.range_margin_rad + APPROACH_RAD)
    back = flange_from_tool.inverse()
    begin = kinematics.solve_branch(Pose.from_transform(approach @ back), branch, near_rad)
    plan_joint_move(
        kinematics, near_rad, begin, limits
    )  # raises if the margin of the joint ranges forbids it
    x, y, z = flange_from_tool.translation_mm.tolist()
    line = plan_line(kinematics, begin, Pose.from_transform(pose @ back), limits, (x, y, z))
    return Posture(begin, line)


def _solutions(kinematics: Kinematics, flange: Transform) -> tuple[Solution, ...]:
    try:
        return kinematics.solutions(Pose.from_transform(flange))
    except LimitError:
        return ()
