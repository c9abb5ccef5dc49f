"""Check that the arm can execute the whole procedure: every pose, approach and line in a single branch.

Poses are checked in the order of the procedure: all localizations, then every target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from procedures.planning.motions import find_unclear
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.visits import (
    ArmSetting,
    Axes,
    PathCheck,
    Reached,
    Unmet,
    Visit,
    build_target_visit,
    list_localizations,
    list_visits,
)
from procedures.strategies.strategy import APPROACH_RAD
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch, Kinematics, Solution
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, vector3


def check_paths(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike
) -> PathCheck:
    """Find one branch in which the arm can execute every pose and line of the procedure.

    Trajectories and fiducials (n, 3) are in CT mm. The start's own branch is tried first, then the others by
    how little the joints turn. If none works, the result lists the failures in the best of them.
    """
    return check_axes(setting, Axes.of(setting, trajectories, fiducials_mm), fiducials_mm)


def check_axes(setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike) -> PathCheck:
    """Check axes that have already been turned; otherwise like `check_paths`."""
    best: PathCheck | None = None
    for branch in order_branches(setting, axes, fiducials_mm):
        checked = check_branch(setting, axes, fiducials_mm, branch)
        if checked.passed:
            return checked
        if best is None or len(checked.unmet) < len(best.unmet):
            best = checked
    return best or PathCheck(None, (), ())


def order_branches(setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike) -> tuple[Branch, ...]:
    """Return the branches for these axes, most promising first."""
    own = setting.kinematics.branch_of(setting.start_rad)
    try:
        visits = list_visits(setting, axes, fiducials_mm, own)
    except LimitError:  # poses depend on the branch: the start's own has none
        visits = tuple(build_target_visit(setting, trajectory) for trajectory in axes.targeted)
    flanges = [visit.pose @ _select_tool(setting, visit).inverse() for visit in visits]
    return rank_branches(setting.kinematics, flanges, setting.start_rad)


def check_branch(
    setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike, branch: Branch, *, first_only: bool = False
) -> PathCheck:
    """Solve for the joints at every pose in this branch, in order, and list the failures.

    Clearance of the motions between them is checked last, once all poses are reached. With `first_only` it
    stops at the first failure.
    """
    near_rad, largest_rad = setting.start_rad, 0.0
    reached: list[Reached] = []
    unmet: list[Unmet] = []
    for visit in _iterate_visits(setting, axes, fiducials_mm, branch, unmet):
        if first_only and unmet:
            break
        try:
            here = solve_visit(
                setting.kinematics, visit, _select_tool(setting, visit), branch, near_rad, setting.limits
            )
        except LimitError as error:
            unmet.append(Unmet.from_error(visit.name, error))
            continue
        turns_rad = (abs(to - at) for at, to in zip(near_rad, here.approach_rad, strict=True))
        near_rad, largest_rad = here.approach_rad, max(largest_rad, *turns_rad)
        reached.append(here)
    check = PathCheck(branch, tuple(reached), tuple(unmet), largest_rad)
    if setting.scene is None or not check.passed:
        return check
    return replace(
        check, unmet=find_unclear(setting, setting.scene, check, axes.targeted, first_only=first_only)
    )


def _iterate_visits(
    setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike, branch: Branch, unmet: list[Unmet]
) -> Iterator[Visit]:
    """Yield visits in order. Axes without localization poses in this branch are added to `unmet`."""
    for axis in axes.localized:
        try:
            yield from list_localizations(setting, axis, fiducials_mm, branch)
        except LimitError as error:
            unmet.append(Unmet.from_error(PoseName(PoseKind.FIDUCIALS, axis.identifier), error))
    for trajectory in axes.targeted:
        yield build_target_visit(setting, trajectory)


def _select_tool(setting: ArmSetting, visit: Visit) -> Transform:
    if visit.name.kind is PoseKind.FIDUCIAL and setting.flange_from_stereo is not None:
        return setting.flange_from_stereo
    return setting.flange_from_tool


def rank_branches(
    kinematics: Kinematics, flanges: Sequence[Transform], start_rad: JointVector
) -> tuple[Branch, ...]:
    """Sort the branches by the number of flange poses they reach, preferring the start's branch in a tie.

    Among others that reach equally many, the one whose joints stay closest to the start comes first.
    """
    own = kinematics.branch_of(start_rad)
    served = dict.fromkeys(kinematics.branches, 0)
    travel = dict.fromkeys(kinematics.branches, 0.0)
    for flange in flanges:
        nearest: dict[Branch, float] = {}
        for solution in _find_solutions(kinematics, flange):
            distance = math.dist(solution.joints_rad, start_rad)
            nearest[solution.branch] = min(distance, nearest.get(solution.branch, math.inf))
        for branch, distance in nearest.items():
            served[branch] += 1
            travel[branch] += distance
    return tuple(sorted(kinematics.branches, key=lambda one: (-served[one], one != own, travel[one])))


def solve_visit(
    kinematics: Kinematics,
    visit: Visit,
    flange_from_tool: Transform,
    branch: Branch,
    near_rad: JointVector,
    limits: MotionLimits,
) -> Reached:
    """Solve for the joints nearest `near_rad` in `branch` at both ends of the approach line.

    Raises ARM-001 to ARM-005 when an end or a point of the line is not drivable
    within the arm's limits, or leaves no room for the joints to stand back before they settle there.
    """
    limits = replace(limits, range_margin_rad=limits.range_margin_rad + APPROACH_RAD)
    approach, pose = (
        Pose.from_transform(one @ flange_from_tool.inverse()) for one in (visit.approach, visit.pose)
    )
    begin = kinematics.solve_branch(approach, branch, near_rad)
    plan_joint_move(kinematics, near_rad, begin, limits)  # raises beyond the margin of the joint ranges
    line = plan_line(kinematics, begin, pose, limits, vector3(flange_from_tool.translation_mm))
    return Reached(visit, begin, line)


def _find_solutions(kinematics: Kinematics, flange: Transform) -> tuple[Solution, ...]:
    try:
        return kinematics.solutions(Pose.from_transform(flange))
    except LimitError:
        return ()
