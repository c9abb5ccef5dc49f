"""An arm left by a calibration: its surroundings, and the way off a divot that may be raised to it."""

from __future__ import annotations

import math

from scipy.spatial.transform import RigidTransform

from procedures.engine.engine import Engine
from procedures.engine.step import StepKey
from procedures.operator.topic import Topic
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.tip_readings import HOVER_MM, ReadTip
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import around_ball, in_free_room, stand_under
from ronna_hw.frames import Frame, Transform

TIP_KNOWN_MM = 15.0  # how far the tip may be from its record, and the ball from its stated position


def surround_calibration(engine: Engine) -> None:
    """Set the arm's surroundings from what the calibration knows so far, before anything moves."""
    workcell, cell = engine.setting.workcell, engine.setting.surroundings
    tool = workcell.flange_from_tool
    place, found = engine.case.find(BallPlace, None), engine.case.find(GlobalLocalization, None)
    if workcell.tool is MountedTool.GUIDE:
        stand = () if place is None else stand_under(place.result.ball_mm)
        workcell.surround(in_free_room(cell, tool, cell.guide, stand))
    elif place is not None:
        workcell.surround(around_ball(cell, tool, place.result.ball_mm, place.result.others_mm))
    elif found is not None and len(found.result.points_mm):
        ball_mm, *others_mm = found.result.points_mm
        workcell.surround(around_ball(cell, tool, ball_mm, others_mm))
    else:
        workcell.surround(in_free_room(cell, tool, cell.stereo_head))


def over_divot_mm(engine: Engine) -> float | None:
    """Distance of the guide's tip from the divot; None if it is away from it."""
    workcell, place = engine.setting.workcell, engine.case.find(BallPlace, None)
    if workcell.tool is not MountedTool.GUIDE or place is None or workcell.at_home:
        return None
    away_mm = math.dist(workcell.tool_pose().translation_mm, place.result.ball_mm)
    return away_mm if away_mm < HOVER_MM - TIP_KNOWN_MM else None


def leave_divot(engine: Engine) -> None:
    """Back along the guide, as after a reading, once the divot is lowered. Raises PRO-002."""
    away_mm, workcell = over_divot_mm(engine), engine.setting.workcell
    if away_mm is None:
        return
    back_mm = HOVER_MM - away_mm
    engine.context(StepKey(ReadTip.kind)).confirm(
        Topic.CALIBRATION,
        "The arm will leave the divot. Confirm that the divot is lowered, hands are clear of the stand "
        "and the guide, and nobody is within the arm's reach",
        f"{back_mm:.0f} mm back along the guide",
    )
    here = workcell.tool_pose()
    origin = here.translation_mm - back_mm * here.rotation_matrix[:, 2]
    workcell.start()
    workcell.line_to(
        Transform(Frame.ROBOT, Frame.TOOL, RigidTransform.from_components(origin, here.rigid.rotation))
    )
