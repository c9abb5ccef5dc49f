"""The self-check of the stereo head: false alarms and detections, on seeded synthetic looks."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from benchmarks.stereo_head.head_looks import TrueHead, check_looks, observation_set, true_head
from procedures.calibration import Baseline, CheckResult, Observation, calibrate_head, compare_with_baseline
from procedures.calibration.errors import CHECK_UNCERTAIN, HEAD_MOVED, NotTheBaseline
from procedures.calibration.pose_set import plan_calibration_looks
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.errors import EXIT_REFUSED

BALL_MM = np.array([700.0, 20.0, 250.0])
TOOL_DOWN = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
VISITS = 3
TWIST_RAD = float(np.radians(0.01))
BALL_PUT_DOWN_MM = 0.3  # how well the ball's stand brings it back, per axis
TRIALS = 100

Laboratory = tuple[TrueHead, StereoHeadCalibration]


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    """A head and the record of its calibration."""
    head = true_head(seed=3)
    generator = np.random.default_rng(7)
    looks = plan_calibration_looks(TOOL_DOWN, BALL_MM, 64)
    observed = [head.observe(look, BALL_MM, generator) for look in looks]
    return head, calibrate_head(observation_set(head, observed)).stereo_head


def visited(head: TrueHead, ball_mm, generator: np.random.Generator) -> tuple[Observation, ...]:
    looks = check_looks(TOOL_DOWN, BALL_MM)
    return tuple(head.observe(look, ball_mm, generator) for look in looks for _ in range(VISITS))


def baseline_of(laboratory: Laboratory, generator: np.random.Generator) -> Baseline:
    head, record = laboratory
    return Baseline(
        created=datetime(2026, 11, 20, tzinfo=UTC),
        stereo_head=record,
        arm_variant="kr6_r900_sixx",
        looks=visited(head, BALL_MM, generator),
    )


def checked(laboratory: Laboratory, head: TrueHead, seed: int) -> CheckResult:
    generator = np.random.default_rng(seed)
    baseline = baseline_of(laboratory, generator)
    ball = BALL_MM + generator.normal(0.0, BALL_PUT_DOWN_MM, 3)
    return compare_with_baseline(visited(head, ball, generator), baseline)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_sound_head_passes_at_least_99_of_100_checks(laboratory: Laboratory) -> None:
    alarms = sum(not checked(laboratory, laboratory[0], seed).passed for seed in range(TRIALS))
    assert alarms <= 1


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_twist_of_a_hundredth_of_a_degree_is_always_detected(laboratory: Laboratory, side: str) -> None:
    missed = 0
    for seed in range(TRIALS):
        angle = 2.0 * np.pi * seed / TRIALS  # of the axis across the line of sight
        turn = (TWIST_RAD * np.cos(angle), TWIST_RAD * np.sin(angle), 0.0)
        missed += checked(laboratory, laboratory[0].with_twisted_camera(side, turn), seed).passed
    assert missed == 0


@pytest.mark.parametrize("turn", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
def test_a_twist_is_refused_with_its_code(laboratory: Laboratory, turn: tuple[float, ...]) -> None:
    head = laboratory[0].with_twisted_camera("left", tuple(TWIST_RAD * value for value in turn))
    with raises(HEAD_MOVED, match="CAL-006") as refused:
        checked(laboratory, head, 5).require()
    assert refused.value.exit_code == EXIT_REFUSED


def test_a_sound_head_passes_although_the_ball_was_placed_elsewhere(laboratory: Laboratory) -> None:
    result = checked(laboratory, laboratory[0], 5)
    result.require()
    assert np.linalg.norm(result.ball_moved_mm) > 0.1
    assert result.repeatability_mm == pytest.approx(0.015, rel=0.3)


def test_a_mount_that_turned_as_a_whole_is_detected_too(laboratory: Laboratory) -> None:
    turn = (0.0, TWIST_RAD, 0.0)
    both = laboratory[0].with_twisted_camera("left", turn).with_twisted_camera("right", turn)
    result = checked(laboratory, both, 5)
    assert [sign.sounds for sign in result.signs] == [True, False, False]


def test_looks_that_scatter_too_much_are_inconclusive_and_refused(laboratory: Laboratory) -> None:
    shaking = TrueHead(laboratory[0].scene, repeatability_mm=0.1)
    with raises(CHECK_UNCERTAIN, match="CAL-007") as refused:
        checked(laboratory, shaking, 5)
    assert refused.value.exit_code == EXIT_REFUSED


def test_a_check_with_other_poses_than_the_baseline_is_refused(laboratory: Laboratory) -> None:
    generator = np.random.default_rng(5)
    baseline = baseline_of(laboratory, generator)
    good = list(visited(laboratory[0], BALL_MM, generator))
    joints = tuple(angle + 0.01 for angle in good[0].joints_rad)
    for looks in (
        [good[0].model_copy(update={"joints_rad": joints}), *good[1:]],  # other joints
        good[:-2],  # an orientation visited once
        [*good, good[0].model_copy(update={"orientation": 9})],
    ):
        with pytest.raises(NotTheBaseline, match="CAL-008"):
            compare_with_baseline(looks, baseline)
    short = baseline.model_copy(update={"looks": baseline.looks[: 5 * VISITS]})
    with pytest.raises(NotTheBaseline, match="CAL-008"):
        compare_with_baseline(good, short)
