"""Whether the arm can drive the whole procedure: every pose, approach and line in one branch.

Positions are checked in the order in which the procedure visits them: all localizations for every
trajectory, then every target.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from numpy.typing import ArrayLike

from procedures.planning.motions import unclear
from procedures.planning.posture import Posture, place, ranked_branches
from procedures.planning.visits import (
    ArmSetting,
    JointMove,
    PathCheck,
    Reached,
    Unmet,
    Visit,
    VisitKind,
    visits_of,
)
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.kinematics import Branch
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform


def check_paths(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike
) -> PathCheck:
    """Find one branch in which the arm can drive every pose and line of the procedure.

    Trajectories and fiducials (n, 3) are in CT mm. Branches are tried with the start's own first, then by
    how little the joints turn. When none works, the result names what is unmet in the best of them.
    """
    visits = visits_of(setting, trajectories, fiducials_mm)
    best: PathCheck | None = None
    for branch in branches_for(setting, visits):
        checked = drive(setting, visits, branch, trajectories)
        if checked.passed:
            return checked
        if best is None or len(checked.unmet) < len(best.unmet):
            best = checked
    return best or PathCheck(None, (), (), ())


def branches_for(setting: ArmSetting, visits: Sequence[Visit]) -> tuple[Branch, ...]:
    """All branches, the most promising for these visits first."""
    flanges = [_flange(setting, visit) for visit in visits]
    return ranked_branches(setting.kinematics, flanges, setting.start_rad)


@dataclass
class _Journey:
    """The joints and moves collected on the way through the visits."""

    near_rad: JointVector
    last: str = "start"
    reached: list[Reached] = field(default_factory=list)
    moves: list[JointMove] = field(default_factory=list)
    unmet: list[Unmet] = field(default_factory=list)


def drive(
    setting: ArmSetting,
    visits: Sequence[Visit],
    branch: Branch,
    trajectories: Sequence[Trajectory],
    *,
    first_only: bool = False,
) -> PathCheck:
    """Joints for these visits, one after the other, in this branch, and what is unmet in it.

    Clearance of the motions between them is checked last, when all poses are reached; with `first_only` only
    up to the first that is not clear.
    """
    limits = setting.limits or working_limits(setting.kinematics)
    journey = _Journey(setting.start_rad)
    for visit in visits:
        tool = _tool(setting, visit)
        try:
            posture = place(
                setting.kinematics, visit.approach, visit.pose, tool, branch, journey.near_rad, limits
            )
        except LimitError as error:
            reason = error.summary
            journey.unmet.append(Unmet(visit.identifier, f"{reason} [{error.code}]"))
            continue
        _note(journey, visit, posture)
    check = PathCheck(branch, tuple(journey.reached), tuple(journey.moves), tuple(journey.unmet))
    if setting.scene is None or not check.passed:
        return check
    return replace(check, unmet=unclear(setting, setting.scene, check, trajectories, first_only=first_only))


def _note(journey: _Journey, visit: Visit, posture: Posture) -> None:
    turns_rad = [
        abs(after - before) for before, after in zip(journey.near_rad, posture.approach_rad, strict=True)
    ]
    journey.moves.append(JointMove(journey.last, visit.identifier, max(turns_rad)))
    journey.reached.append(Reached(visit, posture.approach_rad, posture.at_rad))
    journey.near_rad, journey.last = posture.approach_rad, visit.identifier


def _tool(setting: ArmSetting, visit: Visit) -> Transform:
    if visit.kind is VisitKind.LOCALIZATION and setting.flange_from_stereo is not None:
        return setting.flange_from_stereo
    return setting.flange_from_tool


def _flange(setting: ArmSetting, visit: Visit) -> Transform:
    return visit.pose @ _tool(setting, visit).inverse()
