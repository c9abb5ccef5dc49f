"""Joint angles for one pose: which branch, which whole turns, and the straight line that leads there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ronna_hw.arm.inverse import Branch, Solution, branch_of, solutions, solve_branch
from ronna_hw.arm.limits import MotionLimits
from ronna_hw.arm.model import ArmModel, radians6
from ronna_hw.arm.planning import plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform

START_RAD: JointVector = radians6(0.0, -90.0, 90.0, 0.0, 90.0, 0.0)  # upright, forearm ahead, tool down
# Where the arm of a theatre begins: as above, with the tool ahead of the wrist and not under the forearm.
HOME_DEG = (0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
ALL_BRANCHES = tuple(
    Branch(overhead, elbow, flipped)
    for overhead in (False, True)
    for elbow in (True, False)
    for flipped in (False, True)
)


@dataclass(frozen=True)
class Posture:
    """Joint angles at the approach point and at the pose, joined by a straight line of the tool."""

    approach_rad: JointVector
    at_rad: JointVector


def ranked_branches(
    model: ArmModel, flanges: Sequence[Transform], start_rad: JointVector
) -> tuple[Branch, ...]:
    """All branches, the one that serves most of the flange poses first; the start's own wins a tie.

    Among the others that serve equally many, the one whose joints stay nearest to the start comes first.
    """
    own = branch_of(model, start_rad)
    served = dict.fromkeys(ALL_BRANCHES, 0)
    travel = dict.fromkeys(ALL_BRANCHES, 0.0)
    for flange in flanges:
        nearest: dict[Branch, float] = {}
        for solution in _solutions(model, flange):
            distance = math.dist(solution.joints_rad, start_rad)
            nearest[solution.branch] = min(distance, nearest.get(solution.branch, math.inf))
        for branch, distance in nearest.items():
            served[branch] += 1
            travel[branch] += distance
    return tuple(sorted(ALL_BRANCHES, key=lambda one: (-served[one], one != own, travel[one])))


def place(
    model: ArmModel,
    approach: Transform,
    pose: Transform,
    flange_from_tool: Transform,
    branch: Branch,
    near_rad: JointVector,
    limits: MotionLimits,
) -> Posture:
    """Joint angles in `branch` at both ends of the approach line, turns nearest to `near_rad`.

    Poses are ROBOT <- TOOL. Raises ARM-001 to ARM-005 when an end or a point of the line cannot be driven.
    """
    back = flange_from_tool.inverse()
    begin = solve_branch(model, Pose.from_transform(approach @ back), branch, near_rad)
    plan_joint_move(model, near_rad, begin, limits)  # raises where the ranges' margin forbids to go there
    x, y, z = flange_from_tool.translation_mm.tolist()
    line = plan_line(model, begin, Pose.from_transform(pose @ back), limits, (x, y, z))
    return Posture(begin, line.target_rad)


def _solutions(model: ArmModel, flange: Transform) -> tuple[Solution, ...]:
    try:
        return solutions(model, Pose.from_transform(flange))
    except LimitError:
        return ()
