"""An arm left by a calibration: its surroundings, and whether it is at a divot that may be raised to it."""

from __future__ import annotations

import math

from procedures.engine.engine import Engine
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.tip_readings import HOVER_MM
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import around_ball, in_free_room, stand_under

TIP_KNOWN_MM = 15.0  # how far the tip may be from its record, and the ball from its stated position


def surround_calibration(engine: Engine) -> None:
    """Set the arm's surroundings from what the calibration knows so far, before anything moves."""
    workcell, surroundings = engine.setting.workcell, engine.setting.surroundings
    tool = workcell.flange_from_tool
    place, found = engine.case.find(BallPlace, None), engine.case.find(GlobalLocalization, None)
    if workcell.tool is MountedTool.GUIDE:
        stand = () if place is None else stand_under(place.result.ball_mm)
        workcell.surround(in_free_room(surroundings, tool, surroundings.guide, stand))
    elif place is not None:
        workcell.surround(around_ball(surroundings, tool, place.result.ball_mm, place.result.others_mm))
    elif found is not None and len(found.result.points_mm):
        ball_mm, *others_mm = found.result.points_mm
        workcell.surround(around_ball(surroundings, tool, ball_mm, others_mm))
    else:
        workcell.surround(in_free_room(surroundings, tool, surroundings.stereo_head))


def guide_at_divot(engine: Engine) -> bool:
    """Whether the arm carries the guide and its tip is where the divot is raised to it."""
    workcell, place = engine.setting.workcell, engine.case.find(BallPlace, None)
    if workcell.tool is not MountedTool.GUIDE or place is None or workcell.place.is_home:
        return False
    away_mm = math.dist(workcell.tool_pose().translation_mm, place.result.ball_mm)
    return away_mm < HOVER_MM - TIP_KNOWN_MM
