"""Dry run of a step: its motions as previewed by the path check, and its gauge motions.

Nothing is asked or moved.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from procedures.engine.case import Case, StepKey, stand_ins
from procedures.engine.setting import CaseSetting
from procedures.planning.motions import BACK, LINE, MOVE
from procedures.planning.pose_name import HOME, PoseKind, PoseName
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.intraoperative_scan import used_spheres
from procedures.steps.clinical.path_check import CheckedPaths, MotionPreview, motions_over_spheres
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import ConfirmedTarget, KnownBases, Relocalization
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.surroundings import planning_scene
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import APPROACHES, CheckedTool
from procedures.steps.clinical.two_arms.ball_looks import LOOKS_PER_POSTURE
from procedures.steps.clinical.two_arms.base_postures import FRAME_LOOKS, POSTURES
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.motions import collect_facts
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.contact import BORE_SPEED_MM_S
from ronna_hw.preview import preview_motion

NO_PATHS = "no path is known in advance: each is planned past the other arm when that rests where it will be"
BOTH_ARMS = (
    NO_PATHS,
    f"{MOVE} of the arm to {FRAME_LOOKS} poses that show the tracker its frame, the assistant home",
    f"{MOVE} of the assistant to {FRAME_LOOKS} poses that show the tracker its frame, the arm home",
    f"{MOVE} of the assistant to up to {POSTURES} places of its ball above the guide's, and at each of the "
    f"arm to up to {LOOKS_PER_POSTURE} poses over the ball",
    f"{MOVE} of both arms to home",
)
OVER_SPHERE_MM = 40.0  # between where the stereo head looks and a sphere: less than between two of them


def describe_planned_motions(case: Case, key: StepKey, setting: CaseSetting) -> tuple[str, ...] | None:
    """Describe a step's motions from the arm's current position, or return None before the path check."""
    stored = case.find(CheckedPaths, None)
    if stored is None:
        return None
    workcell = setting.workcell
    if key.name in (CheckedTool.kind, ConfirmedTarget.kind):
        lines = _preview_over_gauge(case, setting)
        return lines if workcell.master.place.is_home else ("the arm is not home; from home it would", *lines)
    if key.name == KnownBases.kind:
        return BOTH_ARMS
    if key.name == ReachedTarget.kind and len(workcell.arms) > 1:
        return _describe_assistance(key.trajectory)
    paths = stored.result
    if key.name in stand_ins(Relocalization):
        motions = motions_over_spheres(paths.motions, key.trajectory)
    else:
        motions = [one for one in paths.motions if _belongs_to_step(one, key)]
    if workcell.master.place.is_home or not motions or motions[0].start != HOME:
        return _describe_motions(motions)
    sphere_index = _sphere_below(paths, key, workcell)
    if sphere_index is None:
        return "the arm is not home; from home it would", *_describe_motions(motions)
    reached = [number for number, one in enumerate(motions, start=1) if one.end.fiducial == sphere_index]
    return f"the arm is over sphere {sphere_index + 1}; from there", *_describe_motions(
        motions[max(reached, default=0) :]
    )


def _preview_over_gauge(case: Case, setting: CaseSetting) -> tuple[str, ...]:
    """Preview the gauge motions from home; the path check does not record them."""
    workcell = setting.workcell
    scene = planning_scene(setting.surroundings, case.get(CheckedPlan).result, used_spheres(case))
    robot_from_ct = case.get(Correspondence).result.robot_from_ct.transform
    around = scene.with_guide(robot_from_ct, workcell.master.flange_from(MountedTool.GUIDE), None)
    there = workcell.master.settle_motion(radians6(*workcell.tools.guide.gauge.joints_deg), ONE_SIDE)
    motions = (*[there] * APPROACHES, replace(workcell.master.return_motion(), replacement=()))
    kinematics, limits = workcell.master.arm.kinematics, workcell.master.arm.limits()
    facts = collect_facts(
        workcell.master.home_rad,
        kinematics,
        lambda leg, start_rad: preview_motion(kinematics, start_rad, leg, around, limits),
        [replace(one, mover=f"the {MountedTool.GUIDE}") for one in motions],
    )
    names = ("home to the gauge", *["onto the gauge again"] * (APPROACHES - 1), "the gauge to home")
    return tuple(f"{MOVE} {name}, {fact}" for name, fact in zip(names, facts, strict=True))


def _sphere_below(paths: CheckedPaths, key: StepKey, workcell: Workcell) -> int | None:
    """Return the index of the sphere below the stereo head, or None unless a localization was interrupted."""
    if key.name not in stand_ins(Relocalization) or workcell.master.tool is not MountedTool.STEREO_HEAD:
        return None
    here_mm = workcell.master.tool_pose().translation_mm
    away_mm = {
        item.fiducial: math.dist(item.tool_pose.translation_mm, here_mm)
        for item in paths.localizations_for(key.trajectory)
    }
    nearest = min(away_mm, key=away_mm.__getitem__, default=None)
    return nearest if nearest is not None and away_mm[nearest] < OVER_SPHERE_MM else None


def _describe_assistance(trajectory: str | None) -> tuple[str, ...]:
    return (
        "the turn of the holder about the bore, and the way there, are chosen when the guide is in its place",
        f"{MOVE} of the assistant from home to over the guide at {trajectory}",
        f"{LINE} along the bore until the depth stop rests on the guide, up to {BORE_SPEED_MM_S:g} mm/s",
        f"{BACK} on that line, after a confirmation, then {MOVE} to home",
    )


def _describe_motions(motions: Sequence[MotionPreview]) -> tuple[str, ...]:
    return tuple(_describe_motion(one) for one in motions)


def _belongs_to_step(motion: MotionPreview, key: StepKey) -> bool:
    target = PoseName(PoseKind.TARGET, key.trajectory or "")
    if key.name == MountedGuide.kind:
        return motion.end == HOME and motion.start.kind is PoseKind.FIDUCIAL
    if key.name == PositionedGuide.kind:
        return motion.end == target and motion.kind != BACK
    if key.name == Retreated.kind:
        return motion.start == target and motion.kind != LINE
    return False


def _describe_motion(motion: MotionPreview) -> str:
    near = motion.closest
    passing = "" if near is None else f"; {near.first} clears {near.second} by {near.distance_mm:.0f} mm"
    start, end = _name_pose(motion.start), _name_pose(motion.end)
    ends = f"from {end}" if motion.kind == BACK else f"{start} to {end}" if start != end else f"onto {end}"
    speed = f"{motion.duration_s:.1f} s at up to {motion.largest_speed_mm_s:.0f} mm/s"
    return f"{motion.kind} {ends}, {speed}{passing}"


def _name_pose(name: PoseName) -> str:
    return f"{name.trajectory}/{name.words()}" if name.trajectory else name.words()
