"""Can the arm do the whole procedure? Every pose, approach and line, in one branch, before anything moves.

Positions are checked in the order in which the procedure visits them: all localizations for every
trajectory, then every target. Each pose is approached and left along the tool axis, from a point outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.errors import NotReachable
from procedures.planning.posture import START_RAD, Posture, place, ranked_branches
from procedures.strategies.orientation import back_along_axis, require_frames
from procedures.strategies.strategy import Strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.inverse import Branch
from ronna_hw.arm.limits import MotionLimits, working_limits
from ronna_hw.arm.model import ArmModel
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform

if TYPE_CHECKING:
    from procedures.planning.planning_scene import PlanningScene

APPROACH_MM = 60.0  # outside the head, before the fiducial or the entry


class VisitKind(StrEnum):
    """What the arm does at a pose."""

    LOCALIZATION = "localization"
    TARGET = "target"


@dataclass(frozen=True)
class Visit:
    """One pose of the procedure, ROBOT <- TOOL, and its approach point back along the tool axis.

    `identifier` reads like `T1/fiducial 2` (fiducials counted from 0) or `T1/target`. `approach_mm` is the
    distance of the approach point from the pose; retreat is the same line backwards.
    """

    identifier: str
    kind: VisitKind
    trajectory: str
    fiducial: int | None
    pose: Transform
    approach_mm: float

    @property
    def approach(self) -> Transform:
        """The approach pose ROBOT <- TOOL."""
        return back_along_axis(self.pose, self.approach_mm)


@dataclass(frozen=True)
class Reached:
    """A visit with the joint angles chosen for it, at the approach point and at the pose."""

    visit: Visit
    approach_rad: JointVector
    at_rad: JointVector


@dataclass(frozen=True)
class JointMove:
    """A joint move between two approach points; `change_rad` per axis."""

    start: str
    end: str
    change_rad: JointVector

    @property
    def largest_rad(self) -> float:
        """The largest turn of any axis."""
        return max(abs(value) for value in self.change_rad)


@dataclass(frozen=True)
class Unmet:
    """A precondition that fails: which pose, and why."""

    pose: str
    reason: str


@dataclass(frozen=True)
class PathCheck:
    """The answer: every visit with its joints in one branch, or what is unmet in the best branch."""

    branch: Branch | None
    reached: tuple[Reached, ...]
    moves: tuple[JointMove, ...]
    unmet: tuple[Unmet, ...]

    @property
    def passed(self) -> bool:
        """Whether the whole procedure can be driven in this branch."""
        return not self.unmet

    @property
    def joint_ranges_rad(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest angle per axis over all poses; empty when nothing is reached."""
        angles = [joints for one in self.reached for joints in (one.approach_rad, one.at_rad)]
        return tuple((min(axis), max(axis)) for axis in zip(*angles, strict=True))

    def at(self, identifier: str) -> Reached:
        """The visit with this identifier; raises KeyError."""
        for one in self.reached:
            if one.visit.identifier == identifier:
                return one
        raise KeyError(identifier)

    def require(self) -> None:
        """Raises PLAN-007 with every unmet precondition."""
        if self.unmet:
            lines = "; ".join(f"{one.pose}: {one.reason}" for one in self.unmet)
            raise NotReachable(f"{len(self.unmet)} pose(s) cannot be driven: {lines}")

    def as_payload(self) -> dict[str, Any]:
        """Plain numbers for a record."""
        return {
            "passed": self.passed,
            "branch_status": None if self.branch is None else self.branch.status,
            "poses": [
                {
                    "id": one.visit.identifier,
                    "kind": one.visit.kind.value,
                    "approach_rad": list(one.approach_rad),
                    "at_rad": list(one.at_rad),
                }
                for one in self.reached
            ],
            "moves": [
                {"from": move.start, "to": move.end, "largest_rad": move.largest_rad} for move in self.moves
            ],
            "unmet": [{"pose": one.pose, "reason": one.reason} for one in self.unmet],
        }


@dataclass(frozen=True)
class ArmSetting:
    """The arm as the check needs it: where the CT is thought to be, what hangs on the flange, the start.

    `robot_from_ct` is the coarse transform, `flange_from_tool` the guide, `flange_from_stereo` the stereo
    head's tool centre point (by design the same; None takes the guide's). With a `scene`, every motion must
    also be clear of what is in it.
    """

    model: ArmModel
    robot_from_ct: Transform
    flange_from_tool: Transform
    strategy: Strategy
    flange_from_stereo: Transform | None = None
    start_rad: JointVector = START_RAD
    limits: MotionLimits | None = None
    approach_mm: float = APPROACH_MM
    scene: PlanningScene | None = None

    def __post_init__(self) -> None:
        """Raises FRM-001 when a transform maps between other frames."""
        require_frames(self.robot_from_ct, Frame.ROBOT, Frame.CT)
        require_frames(self.flange_from_tool, Frame.FLANGE, Frame.TOOL)
        if self.flange_from_stereo is not None:
            require_frames(self.flange_from_stereo, Frame.FLANGE, Frame.TOOL)


def visits_of(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike
) -> tuple[Visit, ...]:
    """All poses in the order of the procedure: localizations, then, after the tool change, targets."""
    points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    localized = trajectories if setting.strategy.localizes_per_trajectory else trajectories[:1]
    visits = []
    for trajectory in localized:
        poses = setting.strategy.localization_poses(trajectory, points, setting.robot_from_ct)
        for index, pose in enumerate(poses):
            identifier = f"{trajectory.identifier}/fiducial {index}"
            visits.append(
                Visit(
                    identifier,
                    VisitKind.LOCALIZATION,
                    trajectory.identifier,
                    index,
                    pose,
                    setting.approach_mm,
                )
            )
    for trajectory in trajectories:
        pose = setting.strategy.target_pose(trajectory, setting.robot_from_ct)
        away_mm = trajectory.depth_mm + setting.approach_mm
        identifier = f"{trajectory.identifier}/target"
        visits.append(Visit(identifier, VisitKind.TARGET, trajectory.identifier, None, pose, away_mm))
    return tuple(visits)


def check_paths(
    setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike
) -> PathCheck:
    """Find one branch in which the arm can drive every pose and line of the procedure.

    Trajectories and fiducials (n, 3) are in CT mm. Branches are tried with the start's own first, then by
    how little the joints turn. When none serves, the answer names what is unmet in the one with the least.
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
    """All branches in the order in which they are worth trying for these visits."""
    flanges = [_flange(setting, visit) for visit in visits]
    return ranked_branches(setting.model, flanges, setting.start_rad)


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

    Whether the motions between them are clear is asked last, when all poses are reached; with `first_only` no
    further than to the first that is not.
    """
    limits = setting.limits or working_limits(setting.model)
    journey = _Journey(setting.start_rad)
    for visit in visits:
        tool = _tool(setting, visit)
        try:
            posture = place(setting.model, visit.approach, visit.pose, tool, branch, journey.near_rad, limits)
        except LimitError as error:
            reason = "; ".join(part for part in (error.what, _values(error)) if part)
            journey.unmet.append(Unmet(visit.identifier, f"{reason} [{error.code}]"))
            continue
        _note(journey, visit, posture)
    check = PathCheck(branch, tuple(journey.reached), tuple(journey.moves), tuple(journey.unmet))
    if setting.scene is None or not check.passed:
        return check
    from procedures.planning.motions import unclear  # which looks at what is found here

    return replace(check, unmet=unclear(setting, setting.scene, check, trajectories, first_only=first_only))


def _note(journey: _Journey, visit: Visit, posture: Posture) -> None:
    A1, A2, A3, A4, A5, A6 = (
        after - before for before, after in zip(journey.near_rad, posture.approach_rad, strict=True)
    )
    journey.moves.append(JointMove(journey.last, visit.identifier, (A1, A2, A3, A4, A5, A6)))
    journey.reached.append(Reached(visit, posture.approach_rad, posture.at_rad))
    journey.near_rad, journey.last = posture.approach_rad, visit.identifier


def _tool(setting: ArmSetting, visit: Visit) -> Transform:
    if visit.kind is VisitKind.LOCALIZATION and setting.flange_from_stereo is not None:
        return setting.flange_from_stereo
    return setting.flange_from_tool


def _flange(setting: ArmSetting, visit: Visit) -> Transform:
    return visit.pose @ _tool(setting, visit).inverse()


def _values(error: LimitError) -> str:
    return ", ".join(
        f"{label} {value}" for label, value in (("limit", error.limit), ("found", error.last)) if value
    )
