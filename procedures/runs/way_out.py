"""Leaving the head in an interrupted run: collision bodies, and any instrument left in the guide.

The valid registration gives the place of the head, or else the last valid one. A lost block of the journal
may have contained the lines about an instrument. So the position of a mounted guide is compared with the axis
of every registered trajectory, and the joints with those at the gauge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from procedures.engine.case import StepKey, results_of, stand_ins
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.errors import RECOVERY_REFUSED
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.tip_readings import HOVER_MM
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.positioning import PositionedGuide, insertion_for
from procedures.steps.clinical.results import RegisteredRobot, Relocalization
from procedures.steps.clinical.surroundings import planning_scene_of, surround_guide, surround_stereo_head
from procedures.steps.clinical.two_arms.insertion_axis import surround_at_guide
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import stands_at
from procedures.workcell.assistant import Assistant
from procedures.workcell.ball_watcher import build_ball_surroundings, build_free_surroundings, build_stand
from procedures.workcell.errors import TipOffAxis
from ronna_hw.frames import Transform

TIP_KNOWN_MM = 15.0  # how far the tip may be from its record, and the ball from its stated position
MOVED_SINCE = (
    "something has moved since the arm came to the head: on its way out it keeps clear of the head's former "
    "position"
)
AT_GAUGE_RAD = math.radians(0.5)  # an arm stopped on its way is farther off, or the question is superfluous
AT_START_MM = 1.0  # at the start of the approach it is away; the arm arrives there much more accurately


def surround_arms(engine: Engine) -> None:
    """Set the collision surroundings of every arm before any motion.

    Raises PRO-032 for an arm away from home if no result gives the position of the head.
    """
    _surround_master(engine)
    for arm in engine.setting.workcell.assistants:
        if arm.history.base is not None:
            _surround_assistant(engine, arm)


def _surround_assistant(engine: Engine, arm: Assistant) -> None:
    """Set the bodies around an assistant: those at the guide, if a guide is registered for its trajectory."""
    workcell = engine.setting.workcell
    trajectory = arm.place.trajectory or workcell.master.place.trajectory
    registration = _find_guide_registration(engine)
    if trajectory is None or registration is None:  # it shows its ball; or somebody has jogged it
        _surround_off_axis(engine, arm)
        return
    at_target = engine.context(StepKey(ReachedTarget.kind, trajectory))
    surround_at_guide(at_target, arm.joints_rad(), registration.robot_from_ct)


def _surround_off_axis(engine: Engine, assistant: Assistant) -> None:
    """Set the bodies around an assistant on no axis: the head as first found, or as last found of old."""
    workcell = engine.setting.workcell
    found = _find_head(engine)
    if found is None:
        if assistant.place.is_out:
            raise RECOVERY_REFUSED(
                f"the {assistant.name} is not home, and no result gives the position of the head",
                action="Jog it home with its controller's pendant, then resume again.",
            )
        return
    head = workcell.master.flange_from(MountedTool.STEREO_HEAD)
    scene = planning_scene_of(_context_over_head(engine))
    assistant.surround(scene.with_stereo_head(found, head, None))


def _find_head(engine: Engine) -> Transform | None:
    """Return the coarse pose of the head, robot <- CT: the valid one, or else the last one of old."""
    standing = engine.case.find(Correspondence, None)
    former = results_of(Correspondence, engine.case.records)
    if standing is None and not former:
        return None
    return (former[-1] if standing is None else standing).result.robot_from_ct.transform


def _context_over_head(engine: Engine) -> StepContext:
    """Return the context of the first step in which the stereo head looks at the head."""
    over = next(key for key in engine.order.sequence if key.name in stand_ins(Relocalization))
    return engine.context(over)


def _surround_master(engine: Engine) -> None:
    master = engine.setting.workcell.master
    if engine.setting.clinical is None:
        _surround_calibration(engine)
    elif master.tool is MountedTool.STEREO_HEAD and engine.case.find(Correspondence, None) is not None:
        surround_stereo_head(_context_over_head(engine), master.joints_rad())  # where the way out begins
    elif (former := _find_former_head(engine)) is not None:
        tool = master.flange_from(MountedTool.STEREO_HEAD)
        scene = planning_scene_of(_context_over_head(engine))
        master.surround(scene.with_stereo_head(former, tool, None), master.joints_rad())
    elif (guide := _find_guide_registration(engine)) is not None:
        surround_guide(engine.context(guide.key), guide.robot_from_ct, master.joints_rad())
    elif not master.place.is_home:
        raise RECOVERY_REFUSED(
            f"the {master.spoken_name} is not home, and no result gives the position of the head",
            action=f"Jog the {master.spoken_name} home with the controller's pendant, then resume again.",
        )


def has_head_moved(engine: Engine) -> bool:
    """Whether the arm is, or the guide was, where only a result that is no longer valid has the head."""
    guide = _find_guide_registration(engine)
    return _find_former_head(engine) is not None if guide is None else not guide.is_valid


def _find_former_head(engine: Engine) -> Transform | None:
    """Return the last pose of a head that the stereo head has come to, if it is no longer valid."""
    master = engine.setting.workcell.master
    if engine.setting.clinical is None or master.tool is not MountedTool.STEREO_HEAD or master.place.is_home:
        return None
    return None if engine.case.find(Correspondence, None) is not None else _find_head(engine)


def find_guide_axis(engine: Engine) -> tuple[InsertionAxis, float] | None:
    """Return the insertion whose axis the guide is on and its travel in mm, or None."""
    master, case = engine.setting.workcell.master, engine.case
    paths = case.find(CheckedPaths, None) if master.tool is MountedTool.GUIDE else None
    if paths is None:
        return None
    tool = master.tool_pose()
    for key in engine.order.sequence:
        registered = case.find(RegisteredRobot, key.trajectory)
        is_positioned_there = key.name == PositionedGuide.kind and key.trajectory in paths.result.targets
        if not is_positioned_there or registered is None:
            continue
        insertion = insertion_for(engine.context(key), registered.result.robot_from_ct_at(key.trajectory))
        try:
            insertion.check_on_axis(tool)
        except TipOffAxis:
            continue
        travel_mm = insertion.travel_from_start_mm(tool)
        if travel_mm > AT_START_MM:
            return insertion, travel_mm
    return None


def is_guide_in_gauge(engine: Engine) -> bool:
    """Whether the arm holds the guide over the gauge, where the mandrel is inserted."""
    workcell = engine.setting.workcell
    if workcell.master.tool is not MountedTool.GUIDE:
        return False
    gauge_rad = tuple(map(math.radians, workcell.tools.guide.gauge.joints_deg))
    return stands_at(workcell.master.joints_rad(), gauge_rad, AT_GAUGE_RAD)


def is_guide_at_divot(engine: Engine) -> bool:
    """Whether the arm holds the tip of the guide at the raised divot."""
    workcell, place = engine.setting.workcell, engine.case.find(BallPlace, None)
    if workcell.master.tool is not MountedTool.GUIDE or place is None or workcell.master.place.is_home:
        return False
    away_mm = math.dist(workcell.master.tool_pose().translation_mm, place.result.ball_mm)
    return away_mm < HOVER_MM - TIP_KNOWN_MM


def _surround_calibration(engine: Engine) -> None:
    """Set the collision surroundings from a calibration's results so far."""
    master, surroundings = engine.setting.workcell.master, engine.setting.surroundings
    tool = master.flange_from_tool
    place, found = engine.case.find(BallPlace, None), engine.case.find(GlobalLocalization, None)
    if master.tool is MountedTool.GUIDE:
        stand = () if place is None else build_stand(place.result.ball_mm)
        master.surround(build_free_surroundings(surroundings, tool, surroundings.guide, stand))
        return
    if place is not None:
        ball_mm, others_mm = place.result.ball_mm, place.result.others_mm
    elif found is not None and len(found.result.points_mm):
        ball_mm, *others = found.result.points_mm
        others_mm = tuple(others)
    else:
        master.surround(build_free_surroundings(surroundings, tool, surroundings.stereo_head))
        return
    master.surround(build_ball_surroundings(surroundings, tool, ball_mm, others_mm))


@dataclass(frozen=True)
class _GuideRegistration:
    """Registration used to position the guide, and whether it is still valid."""

    key: StepKey  # of the step that positions the guide
    robot_from_ct: Transform
    is_valid: bool


def _find_guide_registration(engine: Engine) -> _GuideRegistration | None:
    """Return the registration for the guide's trajectory: the valid one, or else the last superseded one."""
    master, case = engine.setting.workcell.master, engine.case
    if master.tool is not MountedTool.GUIDE:
        return None
    keys = [
        key
        for key in engine.order.sequence
        if key.name == PositionedGuide.kind and master.place.trajectory in (None, key.trajectory)
    ]
    for key in keys:
        registered = case.find(RegisteredRobot, key.trajectory)
        if registered is not None and registered.record.identifier not in case.finished_before_move:
            pose = registered.result.robot_from_ct_at(key.trajectory)
            return _GuideRegistration(key, pose, is_valid=True)
    for former in reversed(results_of(RegisteredRobot, case.records)):
        for key in keys:
            if former.record.trajectory in (None, key.trajectory):
                pose = former.result.robot_from_ct_at(key.trajectory)
                return _GuideRegistration(key, pose, is_valid=False)
    return None
