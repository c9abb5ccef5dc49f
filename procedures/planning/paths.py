"""Whether the arm can execute the whole procedure: every pose, approach and line in one branch.

Poses are checked in the order of the procedure: all localizations, then every target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from numpy.typing import ArrayLike

from procedures.planning.motions import unclear
from procedures.planning.visits import (
    ArmSetting,
    Axes,
    JointMove,
    PathCheck,
    Reached,
    Unmet,
    Visit,
    VisitKind,
    localizations_along,
    target_visit,
    visits_of,
)
from procedures.strategies.strategy import APPROACH_RAD
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch, Kinematics, Solution
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector


def check_paths(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike
) -> PathCheck:
    """Find one branch in which the arm can execute every pose and line of the procedure.

    Trajectories and fiducials (n, 3) are in CT mm. The start's own branch is tried first, then the others by
    how little the joints turn. If none works, the result lists the failures in the best of them.
    """
    return check_axes(setting, Axes.of(setting, trajectories, fiducials_mm), fiducials_mm)


def check_axes(setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike) -> PathCheck:
    """Check axes that have already been turned; otherwise as `check_paths`."""
    best: PathCheck | None = None
    for branch in branches_for(setting, axes, fiducials_mm):
        checked = drive(setting, axes, fiducials_mm, branch)
        if checked.passed:
            return checked
        if best is None or len(checked.unmet) < len(best.unmet):
            best = checked
    return best or PathCheck(None, (), (), ())


def branches_for(setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike) -> tuple[Branch, ...]:
    """Branches in order of promise for these axes."""
    own = setting.kinematics.branch_of(setting.start_rad)
    try:
        visits = visits_of(setting, axes, fiducials_mm, own)
    except LimitError:  # poses depend on the branch: the start's own has none
        visits = tuple(target_visit(setting, trajectory) for trajectory in axes.targeted)
    flanges = [_flange(setting, visit) for visit in visits]
    return ranked_branches(setting.kinematics, flanges, setting.start_rad)


def drive(
    setting: ArmSetting,
    axes: Axes,
    fiducials_mm: ArrayLike,
    branch: Branch,
    *,
    first_only: bool = False,
) -> PathCheck:
    """Joints for every pose in order, in this branch, and what fails in it.

    Clearance of the motions between them is checked last, once all poses are reached. With `first_only` it
    stops at the first failure.
    """
    limits = setting.limits
    journey = _Journey(setting.start_rad)
    for visit in _poses(journey, setting, axes, fiducials_mm, branch):
        if first_only and journey.unmet:
            break
        tool = _tool(setting, visit)
        try:
            posture = place(
                setting.kinematics, visit.approach, visit.pose, tool, branch, journey.near_rad, limits
            )
        except LimitError as error:
            journey.unmet.append(Unmet.by(visit.identifier, error))
            continue
        _note(journey, visit, posture)
    check = PathCheck(branch, tuple(journey.reached), tuple(journey.moves), tuple(journey.unmet))
    if setting.scene is None or not check.passed:
        return check
    unmet = unclear(setting, setting.scene, check, axes.targeted, first_only=first_only)
    return replace(check, unmet=unmet)


@dataclass
class _Journey:
    """The joints and moves collected while going through the visits."""

    near_rad: JointVector
    last: str = "start"
    reached: list[Reached] = field(default_factory=list)
    moves: list[JointMove] = field(default_factory=list)
    unmet: list[Unmet] = field(default_factory=list)


def _poses(
    journey: _Journey, setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike, branch: Branch
) -> Iterator[Visit]:
    """The visits; axes for which the strategy finds no poses in this branch are failures."""
    for axis in axes.localized:
        try:
            yield from localizations_along(setting, axis, fiducials_mm, branch)
        except LimitError as error:
            journey.unmet.append(Unmet.by(f"{axis.identifier}/fiducials", error))
    for trajectory in axes.targeted:
        yield target_visit(setting, trajectory)


def _note(journey: _Journey, visit: Visit, posture: Posture) -> None:
    turns_rad = [
        abs(after - before) for before, after in zip(journey.near_rad, posture.approach_rad, strict=True)
    ]
    journey.moves.append(JointMove(journey.last, visit.identifier, max(turns_rad)))
    journey.reached.append(Reached(visit, posture.approach_rad, posture.line))
    journey.near_rad, journey.last = posture.approach_rad, visit.identifier


def _tool(setting: ArmSetting, visit: Visit) -> Transform:
    if visit.kind is VisitKind.LOCALIZATION and setting.flange_from_stereo is not None:
        return setting.flange_from_stereo
    return setting.flange_from_tool


def _flange(setting: ArmSetting, visit: Visit) -> Transform:
    return visit.pose @ _tool(setting, visit).inverse()


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
    """Branches ordered by how many of the flange poses they reach; the start's own wins a tie.

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
