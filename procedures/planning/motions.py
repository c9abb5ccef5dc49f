"""Motions of the procedure with the mounted tool, previewed and checked for clearance.

The stereo head goes straight over each sphere. Where that is not clear, it backs off from the last one and
approaches along its axis; a move between two such points that is not clear goes via home if that is clear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from procedures.planning.pose_name import GAUGE, HOME, MARKER, PoseKind, PoseName, name_body
from procedures.planning.scene import PlanningScene
from procedures.planning.visits import ArmSetting, PathCheck, Reached, Unmet
from procedures.strategies.strategy import AXIAL_SPEED_FRACTION, ONE_SIDE, approach_joints
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import ClosestPair, sweep_path
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line, require_in_range
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.errors import LimitError
from ronna_hw.preview import preview
from ronna_hw.vectors import JointVector

MOVE, LINE, BACK, RESERVE = "move", "line", "back", "reserve"
AT_THE_END = 0.95  # of a line: 3 mm from where it ends


@dataclass(frozen=True)
class Motion:
    """A motion of the procedure: a joint move between named positions, or a straight line at one of them.

    `plan` is at working speed; the arm drives it at `speed_fraction` of that. `is_cleared` says that another
    sweep covers it: the one that chose it, or that of the line it retraces (`is_retrace`). One in `reserve`
    is driven only if the head has to back off from a sphere that it reached directly.
    """

    start: PoseName
    end: PoseName
    plan: MotionPlan
    around: Surroundings
    is_cleared: bool = False
    is_retrace: bool = False
    is_reserve: bool = False
    speed_fraction: float = 1.0

    @property
    def kind(self) -> str:
        """Motion type: `move` (joints), `line`, `back` (a retraced line), or `reserve`."""
        if self.is_retrace or self.is_reserve:
            return BACK if self.is_retrace else RESERVE
        return MOVE if self.plan.target is None else LINE


@dataclass(frozen=True)
class PreviewedMotion:
    """A motion with its preview."""

    motion: Motion
    preview: PathPreview

    def as_payload(self) -> dict[str, Any]:
        """Return plain values for a record."""
        motion = self.motion
        ends = {"from": str(motion.start), "to": str(motion.end), "kind": motion.kind}
        return {**ends, **self.preview.as_payload()}


def find_unclear(
    setting: ArmSetting,
    scene: PlanningScene,
    check: PathCheck,
    trajectories: Sequence[Trajectory],
    *,
    first_only: bool = False,
) -> tuple[Unmet, ...]:
    """Find motions with insufficient clearance, once all poses are reached.

    With `first_only` it stops at the first and skips its closest point: for trying many angles.
    """
    found: dict[PoseName, Unmet] = {}
    standoffs_mm = {PoseName(PoseKind.TARGET, one.identifier): one.standoff_mm for one in trajectories}
    for motion in plan_motions(setting, scene, check, trajectories):
        if motion.is_cleared:
            continue
        arm, closest = setting.kinematics, not first_only
        breach = sweep_path(arm, motion.plan, motion.around, search_closest=closest).refused
        if breach is not None:
            pose = motion.start if motion.end == HOME else motion.end
            short_mm = motion.around.margin_mm - breach.distance_mm
            told = _describe_collision(motion, breach, standoffs_mm.get(pose))
            found.setdefault(pose, Unmet(pose, *told, short_mm))
            if first_only:
                break
    return tuple(found.values())


def check_fixed_places(setting: ArmSetting) -> tuple[Unmet, ...]:
    """Return why home or gauge is unreachable at any free angle, or () if both can be reached."""
    for name, joints_rad in _list_fixed_places(setting):
        try:
            require_in_range(setting.kinematics, joints_rad, setting.limits)
        except LimitError as error:
            return (Unmet.from_error(name, error),)
    if setting.scene is None:
        return ()
    for motion in _plan_gauge_motions(setting, setting.scene):
        breach = sweep_path(setting.kinematics, motion.plan, motion.around).refused
        if breach is not None:
            return (Unmet(GAUGE, *_describe_collision(motion, breach)),)
    return ()


def _list_fixed_places(setting: ArmSetting) -> Iterator[tuple[PoseName, JointVector]]:
    yield HOME, setting.start_rad
    yield HOME, approach_joints(setting.start_rad, ONE_SIDE)
    if setting.gauge_rad is not None:
        yield GAUGE, setting.gauge_rad
        yield GAUGE, approach_joints(setting.gauge_rad, ONE_SIDE)


def _plan_gauge_motions(setting: ArmSetting, scene: PlanningScene) -> Iterator[Motion]:
    """Plan the motions of the tool check, from home to the gauge and back."""
    if setting.gauge_rad is None:
        return
    around = scene.with_guide(setting.robot_from_ct, setting.flange_from_tool, None)
    onto = plan_joint_move(setting.kinematics, setting.start_rad, setting.gauge_rad, setting.limits)
    yield Motion(HOME, GAUGE, onto, around)
    yield from _plan_homing(setting, (GAUGE, setting.gauge_rad), around)


def preview_motions(
    setting: ArmSetting, scene: PlanningScene, check: PathCheck, trajectories: Sequence[Trajectory]
) -> tuple[PreviewedMotion, ...]:
    """Preview all motions of the procedure in order."""
    return tuple(_preview(setting, motion) for motion in plan_motions(setting, scene, check, trajectories))


def _preview(setting: ArmSetting, motion: Motion) -> PreviewedMotion:
    limits, plan = setting.limits.slowed(motion.speed_fraction), motion.plan
    if motion.speed_fraction < 1.0 and plan.target is not None:
        plan = plan_line(setting.kinematics, plan.start_rad, plan.target, limits, plan.tool_in_flange_mm)
    return PreviewedMotion(motion, preview(setting.kinematics, plan, motion.around, limits))


def plan_motions(
    setting: ArmSetting,
    scene: PlanningScene,
    check: PathCheck,
    trajectories: Sequence[Trajectory],
) -> Iterator[Motion]:
    """Plan the motions from home through all visits and back home, those in reserve where they may come."""
    by_name = {one.identifier: one for one in trajectories}
    here: tuple[PoseName, JointVector] = (HOME, setting.start_rad)
    over: Reached | None = None  # the sphere over which the arm rests
    kind: PoseKind | None = None
    around = Surroundings()
    stereo = setting.flange_from_stereo or setting.flange_from_tool
    for reached in check.reached:
        visit = reached.visit
        if visit.name.kind is PoseKind.FIDUCIAL:
            before, around = around, scene.with_stereo_head(setting.robot_from_ct, stereo)
        else:
            trajectory = by_name[visit.name.trajectory]
            before = around
            around = scene.with_guide(setting.robot_from_ct, setting.flange_from_tool, trajectory)
        if kind is not None and visit.name.kind is not kind:  # tools are exchanged at home
            yield from _back_off(setting, over, before)
            yield from _plan_homing(setting, here, before)
            here, over = (HOME, setting.start_rad), None
        if visit.name.kind is PoseKind.TARGET and kind is not visit.name.kind:
            # Cleared by `check_fixed_places`.
            yield from (replace(one, is_cleared=True) for one in _plan_gauge_motions(setting, scene))
        kind = visit.name.kind
        direct = None
        if visit.name.kind is PoseKind.FIDUCIAL:
            if over is not None and over.visit.name.trajectory != visit.name.trajectory:
                yield from _back_off(setting, over, around)
                over = None
            direct = _plan_direct(setting, here if over is None else over.standing_at, reached, around)
        if direct is not None:
            yield direct
            yield Motion(visit.name, visit.name, reached.line, around, is_reserve=True)
        else:
            yield from _back_off(setting, over, around)
            yield from _plan_visit(setting, here, reached, around)
        here, over = (visit.name, reached.approach_rad), reached
        if visit.name.kind is PoseKind.TARGET:  # and the guide on its gauge, before the next
            yield from _back_off(setting, over, around)
            yield from _plan_homing(setting, here, around)
            here, over = (HOME, setting.start_rad), None
            yield from (replace(one, is_cleared=True) for one in _plan_gauge_motions(setting, scene))
    if kind is PoseKind.FIDUCIAL:
        yield from _back_off(setting, over, around)
        yield from _plan_homing(setting, here, around)


def _plan_direct(
    setting: ArmSetting, here: tuple[PoseName, JointVector], reached: Reached, around: Surroundings
) -> Motion | None:
    """Return the move straight over a sphere, or None if it is not clear."""
    start, joints_rad = here
    plan = plan_joint_move(setting.kinematics, joints_rad, reached.at_rad, setting.limits)
    if sweep_path(setting.kinematics, plan, around, search_closest=False).refused is not None:
        return None
    return Motion(start, reached.visit.name, plan, around, is_cleared=True)


def _back_off(setting: ArmSetting, at: Reached | None, around: Surroundings) -> Iterator[Motion]:
    """Retrace the line of a visit, if the arm rests at one."""
    if at is None:
        return
    begin_rad, end_rad = at.line.start_rad, at.line.target_rad
    start_pose = setting.kinematics.forward(begin_rad)
    back = replace(at.line, start_rad=end_rad, target_rad=begin_rad, target=start_pose)
    yield Motion(at.visit.name, at.visit.name, back, around, is_cleared=True, is_retrace=True)


def _plan_visit(
    setting: ArmSetting, here: tuple[PoseName, JointVector], reached: Reached, around: Surroundings
) -> Iterator[Motion]:
    start, joints = here
    name, kinematics, limits = reached.visit.name, setting.kinematics, setting.limits
    straight = Motion(start, name, plan_joint_move(kinematics, joints, reached.approach_rad, limits), around)
    if start == HOME:
        yield straight
    elif sweep_path(kinematics, straight.plan, around, search_closest=False).refused is None:
        yield replace(straight, is_cleared=True)
    else:
        yield from _plan_homing(setting, here, around)
        onwards = plan_joint_move(kinematics, setting.start_rad, reached.approach_rad, limits)
        yield Motion(HOME, name, onwards, around)
    onto = AXIAL_SPEED_FRACTION if reached.visit.name.kind is PoseKind.TARGET else 1.0
    yield Motion(name, name, reached.line, around, speed_fraction=onto)


def _plan_homing(
    setting: ArmSetting, here: tuple[PoseName, JointVector], around: Surroundings
) -> Iterator[Motion]:
    start, joints = here
    arm, home_rad, limits = setting.kinematics, setting.start_rad, setting.limits
    back_rad = approach_joints(home_rad, ONE_SIDE)
    yield Motion(start, HOME, plan_joint_move(arm, joints, back_rad, limits), around)
    yield Motion(HOME, HOME, plan_joint_move(arm, back_rad, home_rad, limits), around, is_cleared=True)


def _describe_collision(
    motion: Motion, breach: ClosestPair, standoff_mm: float | None = None
) -> tuple[str, str]:
    """Describe a collision for records, and in a surgeon's words.

    `standoff_mm` is the planned stand-off at the target where the motion ends.
    """
    is_held = standoff_mm is not None and motion.kind == LINE and breach.fraction > AT_THE_END
    near = f"comes within {breach.distance_mm:.1f} mm of"
    if breach.distance_mm < 0.0:
        near = f"runs {-breach.distance_mm:.1f} mm into"

    def tell(start: str, end: str, bodies: tuple[str, str], held: str) -> str:
        way = "on the line to it" if motion.kind == LINE else f"on the path from {start} to {end}"
        place = f"where the guide is held, {held}" if is_held else f"{breach.fraction:.0%} of the way"
        least = f"expected at least {motion.around.margin_mm:g} mm between them"
        return f"{way} the {bodies[0]} {near} the {bodies[1]}, {place}: {least}"

    pair = breach.first, breach.second
    record = tell(
        str(motion.start), str(motion.end), pair, f"with the plan's standoff_mm of {standoff_mm or 0.0:g}"
    )
    start, end = (one.in_sentence(MARKER) for one in (motion.start, motion.end))
    bodies = name_body(breach.first), name_body(breach.second)
    words = tell(start, end, bodies, f"at a stand-off of {standoff_mm or 0.0:g} mm")
    return f"{record} [ARM-007]", words
