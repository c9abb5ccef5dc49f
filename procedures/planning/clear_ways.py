"""Are all ways of the procedure clear of everything? Every move and line, with what hangs on the arm there.

A move between two approach points that is not clear leads by way of home, when that is clear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from procedures.planning.head_shape import HeadShape
from procedures.planning.reach import ArmSetting, PathCheck, Reached, Unmet, VisitKind
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.clearance import Closest, sweep_path
from ronna_hw.arm.limits import MotionLimits, working_limits
from ronna_hw.arm.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.preview import PathPreview, preview
from ronna_hw.arm.surroundings import Corridor, Surroundings
from ronna_hw.cell import CellConfig, ToolBody
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Transform

HOME = "home"
Points = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Way:
    """One motion of the procedure: a joint move or a straight line, from one named place to another."""

    start: str
    end: str
    plan: MotionPlan
    around: Surroundings

    @property
    def kind(self) -> str:
        """`line` or `move`."""
        return "move" if self.plan.target is None else "line"


@dataclass(frozen=True)
class PreviewedWay:
    """A way, and what it will be like."""

    way: Way
    preview: PathPreview

    def as_payload(self) -> dict[str, Any]:
        """Plain numbers for a record."""
        way = self.way
        return {"from": way.start, "to": way.end, "kind": way.kind, **self.preview.as_payload()}


@dataclass(frozen=True)
class Room:
    """The head as the CT shows it, and the cell of the theatre file around it."""

    cell: CellConfig
    head: HeadShape
    fiducials_ct_mm: Points = ()

    def with_stereo_head(self, robot_from_ct: Transform, flange_from_tool: Transform) -> Surroundings:
        """What is around while spheres are localized."""
        return self._around(self.cell.stereo_head, robot_from_ct, flange_from_tool, None)

    def with_guide(
        self, robot_from_ct: Transform, flange_from_tool: Transform, trajectory: Trajectory | None
    ) -> Surroundings:
        """What is around while the guide hangs there; the way of this trajectory into the head is open."""
        corridor = None
        if trajectory is not None:
            entry, target = robot_from_ct.apply([trajectory.entry_mm, trajectory.target_mm]).tolist()
            corridor = Corridor(tuple(entry), tuple(target), self.cell.corridor_mm)
        return self._around(self.cell.guide, robot_from_ct, flange_from_tool, corridor)

    def _around(
        self,
        tool: tuple[ToolBody, ...],
        robot_from_ct: Transform,
        flange_from_tool: Transform,
        corridor: Corridor | None,
    ) -> Surroundings:
        in_robot = Pose.from_matrix(robot_from_ct.as_matrix().tolist())
        return self.cell.surroundings(
            tool,
            Pose.from_matrix(flange_from_tool.as_matrix().tolist()),
            Pose(in_robot.apply(self.head.centre_mm), in_robot.rotation),
            self.head.semi_axes_mm,
            tuple(in_robot.apply(point) for point in self.fiducials_ct_mm),
            corridor,
        )


def unclear(
    setting: ArmSetting,
    room: Room,
    check: PathCheck,
    trajectories: Sequence[Trajectory],
    *,
    first_only: bool = False,
) -> tuple[Unmet, ...]:
    """What stands in the way of a procedure whose poses are all reached; empty when all ways are clear.

    With `first_only` it ends at the first, and says little about it: for trying many angles.
    """
    found: dict[str, Unmet] = {}
    for way in ways_of(setting, room, check, trajectories):
        bad = sweep_path(setting.model, way.plan, way.around, to_the_worst=not first_only).refused
        if bad is not None:
            pose = way.start if way.end == HOME else way.end
            found.setdefault(pose, Unmet(pose, _told(way, bad)))
            if first_only:
                break
    return tuple(found.values())


def previews_of(
    setting: ArmSetting, room: Room, check: PathCheck, trajectories: Sequence[Trajectory]
) -> tuple[PreviewedWay, ...]:
    """Every way of the procedure with its preview, in order."""
    limits = setting.limits or working_limits(setting.model)
    return tuple(
        PreviewedWay(way, preview(setting.model, way.plan, way.around, limits))
        for way in ways_of(setting, room, check, trajectories)
    )


def ways_of(
    setting: ArmSetting, room: Room, check: PathCheck, trajectories: Sequence[Trajectory]
) -> Iterator[Way]:
    """The motions from home through all visits and back home; retreats are the lines backwards."""
    limits = setting.limits or working_limits(setting.model)
    by_name = {one.identifier: one for one in trajectories}
    stands: tuple[str, JointVector] = (HOME, setting.start_rad)
    kind: VisitKind | None = None
    around = Surroundings()
    stereo = setting.flange_from_stereo or setting.flange_from_tool
    for reached in check.reached:
        visit = reached.visit
        if visit.kind is VisitKind.LOCALIZATION:
            before, around = around, room.with_stereo_head(setting.robot_from_ct, stereo)
        else:
            trajectory = by_name[visit.trajectory]
            before = around
            around = room.with_guide(setting.robot_from_ct, setting.flange_from_tool, trajectory)
        if kind is not None and visit.kind is not kind:  # the tool is exchanged at home
            yield from _home(setting, stands, limits, before)
            stands = (HOME, setting.start_rad)
        kind = visit.kind
        yield from _to(setting, stands, reached, limits, around)
        stands = (visit.identifier, reached.approach_rad)
    if kind is not None:
        yield from _home(setting, stands, limits, around)


def _to(
    setting: ArmSetting,
    stands: tuple[str, JointVector],
    reached: Reached,
    limits: MotionLimits,
    around: Surroundings,
) -> Iterator[Way]:
    start, joints = stands
    name, model = reached.visit.identifier, setting.model
    straight = Way(start, name, plan_joint_move(model, joints, reached.approach_rad, limits), around)
    if start == HOME or sweep_path(model, straight.plan, around, to_the_worst=False).refused is None:
        yield straight
    else:
        yield Way(start, HOME, plan_joint_move(model, joints, setting.start_rad, limits), around)
        onwards = plan_joint_move(model, setting.start_rad, reached.approach_rad, limits)
        yield Way(HOME, name, onwards, around)
    tool = setting.flange_from_tool
    if reached.visit.kind is VisitKind.LOCALIZATION and setting.flange_from_stereo is not None:
        tool = setting.flange_from_stereo
    flange = Pose.from_transform(reached.visit.pose @ tool.inverse())
    x, y, z = tool.translation_mm.tolist()
    yield Way(name, name, plan_line(model, reached.approach_rad, flange, limits, (x, y, z)), around)


def _home(
    setting: ArmSetting, stands: tuple[str, JointVector], limits: MotionLimits, around: Surroundings
) -> Iterator[Way]:
    start, joints = stands
    yield Way(start, HOME, plan_joint_move(setting.model, joints, setting.start_rad, limits), around)


def _told(way: Way, bad: Closest) -> str:
    leads = "on the line to it" if way.kind == "line" else f"on the way from {way.start} to {way.end}"
    near = f"comes within {bad.distance_mm:.1f} mm of"
    if bad.distance_mm < 0.0:
        near = f"runs {-bad.distance_mm:.1f} mm into"
    return (
        f"{leads} the {bad.first} {near} the {bad.second}, "
        f"{bad.parameter:.0%} of the way, limit {way.around.margin_mm:g} mm [ARM-007]"
    )
