"""Calibration of a stereo head from synthetic looks, against the ground truth of their scene."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from benchmarks.stereo_head.head_looks import TrueHead, observation_set, true_head
from procedures.calibration import HeadResult, Observation, ObservationSet, calibrate_head
from procedures.calibration.bundle import LEAST_POSES
from procedures.calibration.errors import BAD_OBSERVATIONS, TOO_FEW_POSES, DegeneratePoses, DoesNotFit
from procedures.calibration.observations import OBSERVATIONS_FILE
from procedures.calibration.pose_set import PlannedLook, plan_calibration_looks
from procedures.cli.calibrating.calibration import compute_calibration
from procedures.relocalization.errors import HEAD_TURNED
from procedures.relocalization.triangulation import check_head
from procedures.runs.calibrations import STEREO_HEAD
from procedures.runs.request import CalibrationProcedure, RunRequest
from ronna_hw.arm.errors import LimitError
from ronna_hw.calibration import CalibrationExpired, PoseRecord, ToolTipCalibration
from ronna_hw.errors import EXIT_REFUSED
from sim.world.rigid import inverse, matrix_of

BALL_MM = np.array([700.0, 20.0, 250.0])
TOOL_DOWN = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
GOAL_MM = 0.03


def looks_at(
    head: TrueHead, seed: int = 1, count: int = 64, plan: tuple[PlannedLook, ...] | None = None
) -> list[Observation]:
    generator = np.random.default_rng(seed)
    plan = plan or plan_calibration_looks(TOOL_DOWN, BALL_MM, count)
    return [head.observe(look, BALL_MM, generator) for look in plan]


@pytest.fixture(scope="module")
def head() -> TrueHead:
    return true_head(seed=3)


@pytest.fixture(scope="module")
def first(head: TrueHead) -> HeadResult:
    """A calibration from a drawing."""
    return calibrate_head(observation_set(head, looks_at(head)))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_tool_centre_is_within_three_hundredths_of_a_millimetre_of_truth(seed: int) -> None:
    head = true_head(seed=seed)
    result = calibrate_head(observation_set(head, looks_at(head, seed)))
    assert head.tool_centre_error_mm(head.record) > 0.5  # what the drawing says is far off
    assert head.tool_centre_error_mm(result.stereo_head) <= GOAL_MM


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_error_of_the_tool_centre_is_as_predicted() -> None:
    ratios = []
    for seed in range(20):
        head = true_head(seed=seed)
        result = calibrate_head(observation_set(head, looks_at(head, seed)))
        error_mm = head.tool_centre_error_mm(result.stereo_head)
        assert error_mm <= GOAL_MM
        ratios.append(error_mm / result.tool_error_mm)
    assert 0.7 <= np.sqrt(np.mean(np.square(ratios))) <= 1.4


def with_its_arm(seed: int) -> tuple[TrueHead, ObservationSet]:
    head, looks = true_head(seed=seed, with_arm=True), []
    generator = np.random.default_rng(seed)
    for look in plan_calibration_looks(TOOL_DOWN, BALL_MM, 96):
        with contextlib.suppress(LimitError):
            looks.append(head.observe(look, BALL_MM, generator))
    return head, observation_set(head, looks[:64])


@pytest.mark.slow
def test_the_errors_of_an_uncalibrated_arm_are_not_attributed_to_the_tool_centre() -> None:
    head, observed = with_its_arm(seed=0)
    plain = calibrate_head(observed, arm_geometry=False).stereo_head
    found = calibrate_head(observed)
    assert found.fit.arm_error_mm > 0.1
    assert found.fit.arm_scatter_mm == pytest.approx(head.repeatability_mm, rel=0.5)
    error_mm = head.tool_centre_error_mm(found.stereo_head)
    assert error_mm < 0.4 * head.tool_centre_error_mm(plain)
    assert error_mm < 2.0 * found.tool_error_mm


@pytest.mark.slow
def test_an_uncalibrated_arm_does_not_hide_a_turned_camera_in_the_stated_error() -> None:
    _, observed = with_its_arm(seed=0)
    found = calibrate_head(observed)
    assert found.stereo_head.stated_error_mm < GOAL_MM < found.tool_error_mm
    with raises(HEAD_TURNED):  # 0.05 degrees
        check_head([(4.0, 4.0)], [0.25], found.stereo_head.stated_error_mm)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_with_uncalibrated_arms_the_error_of_the_tool_centre_is_as_predicted() -> None:
    ratios = []
    for seed in range(40, 60):
        head, observed = with_its_arm(seed)
        result = calibrate_head(observed)
        ratios.append(head.tool_centre_error_mm(result.stereo_head) / result.tool_error_mm)
    assert 0.7 <= np.sqrt(np.mean(np.square(ratios))) <= 1.4


def test_arm_error_and_image_error_are_separated(head: TrueHead) -> None:
    fit = calibrate_head(observation_set(head, looks_at(head, count=80))).fit
    assert fit.arm_error_mm == pytest.approx(head.repeatability_mm, rel=0.25)
    assert fit.image_sigma_px == pytest.approx(head.outline_px, rel=0.5)
    assert fit.ball_mm == pytest.approx(BALL_MM, abs=GOAL_MM)


def test_wrong_looks_do_not_distort_the_result(head: TrueHead) -> None:
    looks = looks_at(head)
    for number in (5, 20, 41):  # another ball, the arm pushed, a glare
        x, y = looks[number].left.centre_px
        left = looks[number].left.model_copy(update={"centre_px": (x + 40.0, y - 15.0)})
        looks[number] = looks[number].model_copy(update={"left": left})
    result = calibrate_head(observation_set(head, looks))
    assert [int(number) for number in np.flatnonzero(~result.fit.used)] == [5, 20, 41]
    assert head.tool_centre_error_mm(result.stereo_head) <= GOAL_MM


def test_the_new_record_is_dated_and_states_its_cameras_and_its_error(head: TrueHead) -> None:
    observed = observation_set(head, looks_at(head))
    record = calibrate_head(observed, life=timedelta(days=7)).stereo_head
    assert (record.left.serial, record.right.serial) == observed.serials
    assert record.created == observed.created
    assert record.expires - record.created == timedelta(days=7)
    assert 0.0 < record.stated_error_mm < GOAL_MM
    record.check_valid_at(observed.created + timedelta(days=6))
    with pytest.raises(CalibrationExpired, match="CAL-001") as refused:
        record.check_valid_at(observed.created + timedelta(days=8))
    assert refused.value.exit_code == EXIT_REFUSED


def tip_at(head: TrueHead, flange_from_tool: PoseRecord) -> ToolTipCalibration:
    return ToolTipCalibration(
        identifier="tip",
        created=head.record.created,
        expires=head.record.expires,
        made_by="a laboratory",
        stated_error_mm=0.05,
        tool_number=2,
        flange_from_tool=flange_from_tool,
    )


def test_the_tip_of_the_guide_moves_with_the_mount_it_shares_with_the_head(head: TrueHead) -> None:
    tip = tip_at(head, head.record.flange_from_tool)
    observed = observation_set(head, looks_at(head)).model_copy(update={"tool_tip": tip})
    moved = calibrate_head(observed).tool_tip
    assert moved is not None
    truth = matrix_of(head.scene.mount.flange_from_tool_true) @ matrix_of(head.scene.mount.tool_from_tip_true)
    off = (inverse(truth) @ matrix_of(moved.flange_from_tool))[:3, 3]
    assert np.linalg.norm(off) < 0.05  # with the error of the record before, which placed the tool frame
    assert (moved.expires, moved.stated_error_mm) == (tip.expires, tip.stated_error_mm)


def test_a_head_that_moved_on_the_mount_leaves_the_tip_where_it_is(head: TrueHead, first: HeadResult) -> None:
    mount = head.scene.mount
    tip = tip_at(head, mount.flange_from_tool_true)
    x, y, z = mount.flange_from_tool_true.translation_mm
    slipped = mount.flange_from_tool_true.model_copy(update={"translation_mm": (x + 0.3, y, z + 0.4)})
    scene = head.scene.model_copy(
        update={"mount": mount.model_copy(update={"flange_from_tool_true": slipped})}
    )
    later = looks_at(replace(head, scene=scene), 2)
    again = observation_set(head, later).model_copy(update={"start": first.stereo_head, "tool_tip": tip})
    second = calibrate_head(again)
    assert second.tool_shift_mm == pytest.approx(0.5, abs=0.05)
    assert first.smallest_slip_mm is None  # from a drawing
    assert second.smallest_slip_mm is not None
    assert second.smallest_slip_mm < 0.1
    assert second.tool_tip == tip
    (warning,) = STEREO_HEAD.figures(second).warnings()
    assert "the head has moved on the mount" in warning


def test_a_second_calibration_confirms_the_first_one(head: TrueHead, first: HeadResult) -> None:
    again = observation_set(head, looks_at(head, 2)).model_copy(update={"start": first.stereo_head})
    second = calibrate_head(again)
    assert first.tool_shift_mm > 0.5
    assert second.tool_shift_mm < GOAL_MM
    assert second.frame_misfit_mm < 0.01


def test_for_a_count_of_zero_no_view_is_planned() -> None:
    assert plan_calibration_looks(Rotation.identity(), (0.0, 0.0, 0.0), 0) == ()


def test_too_few_poses_are_refused(head: TrueHead) -> None:
    with raises(TOO_FEW_POSES, match="CAL-002"):
        calibrate_head(observation_set(head, looks_at(head, count=LEAST_POSES - 1)))


@pytest.mark.parametrize("turned", [False, True])
def test_poses_of_one_orientation_or_about_one_axis_are_refused(head: TrueHead, turned: bool) -> None:
    looks = []
    for number, look in enumerate(plan_calibration_looks(TOOL_DOWN, BALL_MM, 64)):
        turn = TOOL_DOWN * Rotation.from_rotvec([0.0, 0.0, 0.02 * number if turned else 0.0])
        offset = np.array(look.ball_in_tool_mm)
        rigid = type(look.pose.rigid).from_components(BALL_MM - turn.apply(offset), turn)
        looks.append(
            PlannedLook(type(look.pose)(look.pose.target, look.pose.source, rigid), look.ball_in_tool_mm)
        )
    with pytest.raises(DegeneratePoses, match="CAL-003"):
        calibrate_head(observation_set(head, looks_at(head, plan=tuple(looks))))


def test_a_ball_that_moves_is_refused(head: TrueHead) -> None:
    shaken = TrueHead(head.scene, repeatability_mm=3.0)
    with pytest.raises(DoesNotFit, match="CAL-004"):
        calibrate_head(observation_set(head, looks_at(shaken)))


def test_observations_round_trip_through_their_file(head: TrueHead, tmp_path) -> None:
    observed = observation_set(head, looks_at(head, count=3))
    (tmp_path / OBSERVATIONS_FILE).write_text(observed.model_dump_json(by_alias=True))
    assert STEREO_HEAD.read_looks(tmp_path) == observed
    assert STEREO_HEAD.read_looks(tmp_path / OBSERVATIONS_FILE) == observed


@pytest.mark.parametrize("content", [None, "no json", '{"schema": 1}', '{"observations": [{}]}'])
def test_a_file_without_valid_observations_is_refused(tmp_path, content: str | None) -> None:
    if content is not None:
        (tmp_path / OBSERVATIONS_FILE).write_text(content)
    with raises(BAD_OBSERVATIONS, match="CAL-005"):
        STEREO_HEAD.read_looks(tmp_path)


@pytest.mark.parametrize("variance_px2", [0.0, -1e300])
def test_looks_from_which_nothing_can_be_computed_are_refused(head: TrueHead, variance_px2: float) -> None:
    first, *others = looks_at(head, count=LEAST_POSES)
    left = first.left.model_copy(update={"covariance_px2": ((variance_px2, 0.0), (0.0, 1e-4))})
    observed = observation_set(head, [first.model_copy(update={"left": left}), *others])
    with raises(BAD_OBSERVATIONS, match="CAL-005: nothing can be computed"):
        compute_calibration(
            STEREO_HEAD, RunRequest(procedure=CalibrationProcedure(recipe={}, days=1)), observed
        )
