"""Brings the head over the ball: what several calibrations begin with."""

from __future__ import annotations

import numpy as np

from procedures.calibration.errors import PosesOutOfReach
from procedures.calibration.pose_set import calibration_looks
from procedures.engine.context import StepContext
from procedures.operator.question import Topic
from procedures.relocalization.errors import SphereNotInView
from procedures.relocalization.search_pattern import SEARCH_RADIUS_MM
from procedures.steps.calibration.ball_place import BallPlace
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher, around_ball
from procedures.workcell.stereo_picture import pair_picture

BALL_PICTURE = "stereo-ball.png"
SPARE = 1.5  # planned looks for each wanted one: some are out of reach, some show a ball half hidden


def bring_over_ball(
    context: StepContext,
    place: BallPlace,
    purpose: str,
    poses: int,
    *,
    ball: str = "the ball",
    if_missing: str | None = None,
) -> BallWatcher:
    """Confirmed by the operator, the head over the ball, and the ball in view.

    Before anything moves so many poses about the ball must be within reach. Raises CAL-010, PRO-002 unless
    confirmed, STE-009 when the ball is not there, with the advice `if_missing`.
    """
    workcell = context.workcell
    ball_mm = np.array(place.ball_mm)
    watcher = BallWatcher(workcell, ball_mm)
    plan = calibration_looks(place.reference, ball_mm, round(SPARE * poses)) if poses else ()
    reached = sum(watcher.reaches(look.pose) for look in plan)
    if not watcher.reaches(place.first_look.pose) or reached < poses:
        raise PosesOutOfReach(
            "the poses around the ball are out of the arm's reach",
            expected=f"{poses} poses",
            got=f"{reached} of {len(plan)}",
        )
    x, y, z = place.ball_mm
    context.confirm(
        Topic.CALIBRATION,
        f"The arm will move around the ball: {purpose}. Nobody and nothing else may be within its reach",
        f"ball at {x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT",
    )
    tool = workcell.flange_from(MountedTool.STEREO_HEAD)
    workcell.surround(around_ball(context.setting.surroundings, tool, ball_mm, place.others_mm))
    workcell.start(cameras=True)
    workcell.sensors.read_whole()
    try:
        seen = watcher.find(place.first_look)
    except SphereNotInView as error:
        raise SphereNotInView(
            f"{ball} was not seen within {SEARCH_RADIUS_MM:g} mm of {x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT",
            got=error.what,
            action=if_missing,
        ) from error
    context.keep_picture(BALL_PICTURE, pair_picture(seen))
    return watcher
