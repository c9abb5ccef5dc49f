"""Ball acquisitions move only when confirmed and only within reach, and keep what was measured."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from clinical_case import HOME_RAD, IN_VIEW_MM, ClinicalCell
from coded_errors import raises
from prepared_results import checked_set_up
from recording_cell import RecordingOperator
from scipy.spatial.transform import Rotation

from procedures.calibration import Baseline
from procedures.calibration.bundle import LEAST_POSES
from procedures.calibration.errors import POSES_OUT_OF_REACH, TOO_FEW_POSES, NotTheBaseline
from procedures.calibration.pose_set import CHECK_ORIENTATIONS, PlannedLook, self_check_variants
from procedures.engine.order import StepSpec
from procedures.journal.errors import StepRefused
from procedures.journal.results import StepResult
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.relocalization.errors import WRONG_CAMERA, NoSphere, SphereNotInView
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.head_looks import (
    LOOK_IN_PLACE,
    LOOK_OVER_BALL,
    BallMeasurement,
    ObservedBall,
    VisitedBaseline,
    check_look,
    observation_step,
    raise_too_few,
    visit_step,
)
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher
from procedures.workcell.stereo_look import Look
from ronna_hw.calibration import CalibrationExpired, PoseRecord, StereoHeadCalibration
from ronna_hw.devices.lifecycle import Lifecycle

BALL_MM = (720.0, -10.0, 310.0)
OUT_OF_REACH_MM = (2000.0, 0.0, 300.0)
VISITS = 2
EXPIRED = {"expires": datetime.now(UTC) - timedelta(seconds=1)}


def over_ball(cell: ClinicalCell, step: StepSpec[StepResult], at_mm: tuple[float, float, float] = BALL_MM):
    """The result of a step that begins over the ball, which stands at `BALL_MM`."""
    cell.workcell.spheres_mm = np.array([BALL_MM])
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.run(checked_set_up(cell), BallPlace(ball_mm=at_mm, others_mm=()), step)


def observed(cell: ClinicalCell) -> ObservedBall:
    return over_ball(cell, observation_step(LEAST_POSES, VISITS)).result


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> Baseline:
    """What a calibration has left of its check."""
    cell = ClinicalCell(tmp_path_factory.mktemp("calibration"))
    seen = observed(cell).observed
    return Baseline(
        created=seen.created,
        stereo_head=cell.calibrations.stereo_head,
        arm_variant=seen.arm_variant,
        looks=tuple(one for one in seen.observations if one.orientation is not None),
    )


def visited(cell: ClinicalCell, baseline: Baseline) -> VisitedBaseline:
    cell.workcell.spheres_mm = np.array([BALL_MM])
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.run(checked_set_up(cell), visit_step(baseline, VISITS)).result


def with_head(cell: ClinicalCell, head: StereoHeadCalibration) -> ClinicalCell:
    """The same theatre with this record of the head."""
    cell.workcell = cell.make_workcell(cell.calibrations.model_copy(update={"stereo_head": head}))
    return cell


def moved(pose: PoseRecord, by_mm: float) -> PoseRecord:
    x, y, z = pose.translation_mm
    return pose.model_copy(update={"translation_mm": (x + by_mm, y, z)})


def test_a_calibration_has_its_free_poses_and_revisits_the_check_poses_at_the_same_joints(
    cell: ClinicalCell,
) -> None:
    done = observed(cell)
    free = [one for one in done.observed.observations if one.orientation is None]
    check = [one for one in done.observed.observations if one.orientation is not None]
    assert len(free) == LEAST_POSES
    assert [one.orientation for one in check] == [*range(CHECK_ORIENTATIONS)] * VISITS
    assert [one.joints_rad for one in check[:CHECK_ORIENTATIONS]] == [
        one.joints_rad for one in check[CHECK_ORIENTATIONS:]
    ]
    assert done.observed.serials == cell.stereo.serials
    assert done.observed.start == cell.calibrations.stereo_head
    assert done.remarks == ()
    assert cell.arm.joints_rad == HOME_RAD


def test_a_blocked_way_home_is_remarked_on_and_the_observations_are_kept(cell: ClinicalCell) -> None:
    cell.arm.blocked = lambda _start, target: target == HOME_RAD
    assert observed(cell).remarks == ("the arm stays where it is: the way is not clear",)


@pytest.mark.parametrize("step", [observation_step(LEAST_POSES, VISITS), LOOK_OVER_BALL])
def test_the_arm_does_not_move_over_the_ball_without_confirmation(
    cell: ClinicalCell, step: StepSpec[StepResult]
) -> None:
    cell.operator = RecordingOperator(Topic.CALIBRATION)
    with pytest.raises(NotConfirmed, match="The arm will move around the ball"):
        over_ball(cell, step)
    assert cell.arm.motions == cell.arm.calls == []


@pytest.mark.parametrize("step", [observation_step(LEAST_POSES, VISITS), LOOK_OVER_BALL])
def test_a_ball_out_of_reach_is_refused_before_the_operator_is_asked(
    cell: ClinicalCell, step: StepSpec[StepResult]
) -> None:
    with raises(POSES_OUT_OF_REACH, match="CAL-010"):
        over_ball(cell, step, at_mm=OUT_OF_REACH_MM)
    assert cell.operator.asked == []


@pytest.mark.hazard(37)
@pytest.mark.parametrize("step", [observation_step(LEAST_POSES, VISITS), LOOK_OVER_BALL])
def test_the_ball_is_not_observed_with_a_tool_other_than_the_stereo_head(
    cell: ClinicalCell, step: StepSpec[StepResult]
) -> None:
    cell.carrying(MountedTool.GUIDE)
    with pytest.raises(StepRefused, match="the arm carries the guide, not the stereo head"):
        cell.run(checked_set_up(cell), BallPlace(ball_mm=BALL_MM, others_mm=()), step)


@pytest.mark.parametrize("step", [observation_step(LEAST_POSES, VISITS), LOOK_OVER_BALL])
def test_a_missing_ball_is_refused_with_its_position_and_the_option_that_states_it(
    cell: ClinicalCell, step: StepSpec[StepResult]
) -> None:
    with pytest.raises(SphereNotInView, match=r"STE-009.*the ball .*15 mm of 720 50 310 mm") as refused:
        over_ball(cell, step, at_mm=(720.0, 50.0, 310.0))
    assert "--ball X Y Z" in refused.value.advice


def test_one_acquisition_over_the_ball_measures_it_and_returns_home(cell: ClinicalCell) -> None:
    seen = over_ball(cell, LOOK_OVER_BALL).result
    assert seen.position_mm == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert (seen.left is None, seen.reason) == (False, "")
    assert cell.arm.joints_rad == HOME_RAD


def test_an_acquisition_in_place_moves_nothing_connects_only_the_cameras_and_keeps_its_images(
    cell: ClinicalCell,
) -> None:
    engine = cell.begin(LOOK_IN_PLACE)
    engine.run_to()
    seen = cell.case.get(BallMeasurement).result
    assert seen == BallMeasurement(position_mm=None, left=None, right=None, reason="no sphere in view")
    assert engine.setting.memory.find(Look) is not None
    assert cell.stereo.state is Lifecycle.ACTIVE
    assert cell.arm.state is cell.tracker.state is Lifecycle.DISCONNECTED
    assert cell.arm.motions == []


@pytest.mark.hazard(26)
def test_an_expired_calibration_is_refused_before_a_camera_is_connected(cell: ClinicalCell) -> None:
    with_head(cell, cell.calibrations.stereo_head.model_copy(update=EXPIRED))
    with pytest.raises(CalibrationExpired, match="CAL-001"):
        cell.run(LOOK_IN_PLACE)
    assert cell.stereo.state is Lifecycle.DISCONNECTED


@pytest.mark.hazard(25)
def test_a_calibration_of_other_cameras_is_refused(cell: ClinicalCell) -> None:
    cell.stereo.serials = ("1", "2")
    with raises(WRONG_CAMERA, match="STE-010"):
        cell.run(LOOK_IN_PLACE)
    assert cell.stereo.calls == []


def test_a_check_uses_the_joints_of_the_baseline_and_returns_home(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    done = visited(cell, baseline)
    places = [one.joints_rad for one in baseline.looks[:CHECK_ORIENTATIONS]]
    assert [one.joints_rad for one in done.looks] == places * VISITS
    assert [to for _, to in cell.arm.motions[1::2]] == [*places * VISITS, HOME_RAD]
    assert cell.arm.joints_rad == HOME_RAD
    assert done.calibration == cell.calibrations.stereo_head.identifier


def test_a_check_needs_confirmation_and_the_question_names_its_calibration(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    cell.operator = RecordingOperator(Topic.CALIBRATION)
    with pytest.raises(NotConfirmed, match=f"calibration {baseline.stereo_head.identifier}"):
        visited(cell, baseline)
    assert cell.arm.motions == cell.arm.calls == []


@pytest.mark.hazard(26)
def test_a_check_with_an_expired_calibration_is_refused_before_the_operator_is_asked(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    with pytest.raises(CalibrationExpired, match="CAL-001"):
        visited(with_head(cell, baseline.stereo_head.model_copy(update=EXPIRED)), baseline)
    assert cell.operator.asked == []


def test_a_baseline_of_other_camera_poses_than_the_theatre_is_refused_before_the_operator_is_asked(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    head = baseline.stereo_head
    left = head.left.model_copy(update={"camera_from_tool": moved(head.left.camera_from_tool, 0.1)})
    recalibrated = head.model_copy(update={"identifier": "of-the-theatre", "left": left})
    with pytest.raises(NotTheBaseline, match=f"expected of-the-theatre, got {head.identifier}"):
        visited(with_head(cell, recalibrated), baseline)
    assert cell.operator.asked == []


def test_a_baseline_holds_for_a_head_of_which_only_place_on_the_flange_and_dates_are_new(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    """As after a calibration of the arm."""
    head = baseline.stereo_head
    on_flange = moved(head.flange_from_tool, 0.1)
    placed = head.model_copy(update={"identifier": "placed-again", "flange_from_tool": on_flange})
    former = baseline.model_copy(update={"stereo_head": head.model_copy(update=EXPIRED)})
    assert len(visited(with_head(cell, placed), former).looks) == VISITS * CHECK_ORIENTATIONS


@pytest.mark.hazard(25)
def test_a_baseline_of_other_cameras_is_refused_before_the_operator_is_asked(
    cell: ClinicalCell, baseline: Baseline
) -> None:
    cell.stereo.serials = ("1", "2")
    with raises(WRONG_CAMERA, match="STE-010"):
        visited(cell, baseline)
    assert cell.operator.asked == []


def test_a_check_without_a_ball_returns_home_and_reports_why(cell: ClinicalCell, baseline: Baseline) -> None:
    cell.workcell.spheres_mm = np.array([BALL_MM]) + 10 * IN_VIEW_MM
    cell.carrying(MountedTool.STEREO_HEAD)
    with pytest.raises(NoSphere, match=f"{VISITS * CHECK_ORIENTATIONS} x no sphere in view"):
        cell.run(checked_set_up(cell), visit_step(baseline, VISITS))
    assert cell.arm.joints_rad == HOME_RAD


@pytest.mark.parametrize(
    ("reason", "error"), [("ARM-007", POSES_OUT_OF_REACH), ("no sphere in view", TOO_FEW_POSES)]
)
def test_too_few_acquisitions_are_explained_by_the_most_frequent_reason(
    cell: ClinicalCell, reason: str, error: type[Exception]
) -> None:
    watcher = BallWatcher(cell.workcell, np.array(BALL_MM))
    watcher.rejected[reason] = 40
    with raises(error, match=f"40 x {reason}"):
        raise_too_few(watcher, 30)


class Watcher:
    """Takes looks unless they are turned too far; notes the joint angles that it is sent back to."""

    def __init__(self) -> None:
        self.sent_back: list[tuple[float, ...]] = []

    def observe(self, planned: PlannedLook) -> Any:
        turned = planned.pose.rigid.rotation.as_euler("ZYX", degrees=True)[0]
        return (
            None
            if abs(turned) > 30.0
            else SimpleNamespace(orientation=planned.orientation, joints_rad=HOME_RAD)
        )

    def observe_at(self, joints: tuple[float, ...], orientation: int) -> Any:
        self.sent_back.append(joints)
        return SimpleNamespace(orientation=orientation, joints_rad=joints)


def test_an_unusable_check_orientation_is_replaced_by_another() -> None:
    watcher: Any = Watcher()
    variants = self_check_variants(Rotation.identity(), np.array(BALL_MM), 0)
    assert watcher.observe(variants[0]) is None
    seen = [check_look(watcher, variants, [])]
    assert seen[0] is not None
    assert watcher.sent_back == []
    assert check_look(watcher, variants, seen) is not None
    assert watcher.sent_back == [HOME_RAD]  # the next visit is to the very same joint angles
