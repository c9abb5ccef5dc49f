"""The place of the ball: the isolated ball nearest to the head, or the position the operator states."""

import numpy as np
import pytest
from clinical_case import ClinicalCell
from coded_errors import raises
from prepared_results import global_localization

from procedures.calibration.errors import NO_BALL
from procedures.engine.case import Stored
from procedures.steps.calibration.ball_place import BallPlace, place_step
from procedures.workcell import MountedTool
from ronna_hw.errors import EXIT_REFUSED

FAR, NEAR, OTHER = (870.0, 370.0, 1060.0), (720.0, -10.0, 318.0), (600.0, 200.0, 200.0)


def place_among(cell: ClinicalCell, *points_mm: tuple[float, float, float]) -> Stored[BallPlace]:
    """The ball that is chosen when the tracker has seen these."""
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.run(global_localization(np.array(points_mm)), place_step(None))


def test_the_ball_nearest_to_the_head_is_chosen(cell: ClinicalCell) -> None:
    stored = place_among(cell, FAR, NEAR, OTHER)
    assert stored.result.ball_mm == NEAR
    assert stored.result.others_mm == (FAR, OTHER)
    assert list(stored.record.parents) == ["01-global_localization"]


def test_balls_close_together_are_skipped(cell: ClinicalCell) -> None:
    beside = (NEAR[0] + 10.0, NEAR[1], NEAR[2])
    assert place_among(cell, NEAR, beside, OTHER).result.ball_mm == OTHER


def test_the_step_is_refused_without_an_isolated_ball(cell: ClinicalCell) -> None:
    with raises(NO_BALL, match="CAL-009") as refused:
        place_among(cell, (700.0, 0.0, 300.0), (710.0, 0.0, 300.0))
    assert refused.value.exit_code == EXIT_REFUSED


def test_a_stated_place_is_used_without_the_tracker(cell: ClinicalCell) -> None:
    stored = cell.run(place_step(NEAR))
    assert stored.result == BallPlace(ball_mm=NEAR, others_mm=())
    assert stored.record.parents == {}


def test_the_first_look_is_straight_down_on_the_ball() -> None:
    look = BallPlace(ball_mm=NEAR, others_mm=()).first_look.pose
    assert look.translation_mm == pytest.approx(NEAR)
    assert look.rotation_matrix[:, 2] == pytest.approx((0.0, 0.0, -1.0), abs=1e-12)
