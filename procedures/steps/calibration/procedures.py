"""The steps of each calibration, in their order."""

from __future__ import annotations

from procedures.calibration import Baseline
from procedures.engine.order import Steps
from procedures.steps.calibration.ball_look import look_step
from procedures.steps.calibration.ball_observation import observation_step
from procedures.steps.calibration.ball_place import place_step
from procedures.steps.calibration.baseline_visit import visit_step
from procedures.steps.calibration.frame_looks import turning_step
from procedures.steps.calibration.sphere_looks import looks_step
from procedures.steps.calibration.stand_ball import stand_place_step, stand_step
from procedures.steps.calibration.tip_readings import readings_step
from procedures.steps.clinical import global_localization, set_up
from ronna_hw.calibration import Numbers3


def head_calibration(poses: int, visits: int, ball_mm: Numbers3 | None) -> Steps:
    """Set up, find the ball, look at it from all sides."""
    return (*_to_ball(ball_mm), observation_step(poses, visits))


def head_check(baseline: Baseline, visits: int) -> Steps:
    """Set up, and look at the ball as the calibration did."""
    return (set_up.STEP, visit_step(baseline, visits))


def head_look(ball_mm: Numbers3 | None) -> Steps:
    """Set up, find the ball, look at it once."""
    return (*_to_ball(ball_mm), look_step(over_ball=True))


def look_where_it_stands() -> Steps:
    """One look; nothing moves."""
    return (look_step(over_ball=False),)


def arm_looks(count: int, validation: int) -> Steps:
    """Set up, find the spheres, look at them from all sides."""
    return (set_up.STEP, global_localization.STEP, looks_step(count, validation))


def frame_looks(count: int, validation: int) -> Steps:
    """Set up, and turn the reference frame before the tracker."""
    return (set_up.STEP, turning_step(count, validation))


def tip_readings(count: int, validation: int, ball_mm: Numbers3 | None) -> Steps:
    """Set up, look at the ball of the stand, exchange head for guide, read the divot in its place."""
    place = place_step(ball_mm) if ball_mm is not None else stand_place_step()
    return (set_up.STEP, place, stand_step(count + validation), readings_step(validation))


def _to_ball(ball_mm: Numbers3 | None) -> Steps:
    by_tracker: Steps = () if ball_mm is not None else (global_localization.STEP,)
    return (set_up.STEP, *by_tracker, place_step(ball_mm))
