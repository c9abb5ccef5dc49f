"""Bases of two arms by tracker frames and by the stereo head, judged by the truth of simulated scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from coded_errors import raises
from two_arms import REGION_MM, TwoArms, two_arms

from procedures.calibration.base_to_base import BallFit, BallLooks, BaseToBase, refine_bases
from procedures.calibration.errors import BASES_DISAGREE, TOO_FEW_POSES, DegeneratePoses, DoesNotFit

BY_FRAMES_MM, BY_BALL_MM = 0.5, 0.1
MANY = 40
Refine = Callable[[BallLooks], BallFit]


def mean_miss_mm(misses_mm: np.ndarray) -> float:
    return float(np.linalg.norm(misses_mm.mean(axis=0)))


def test_tracker_frames_leave_the_bases_half_a_millimetre_off_at_most_and_the_ball_a_tenth() -> None:
    arms, coarse, fine = two_arms(0, calibrated=True)
    assert mean_miss_mm(arms.coarse_misses(coarse, 20)) <= BY_FRAMES_MM
    assert mean_miss_mm(arms.fine_misses(fine, 20)) <= BY_BALL_MM


@pytest.mark.slow
def test_both_calibrations_keep_their_limits_and_state_their_errors_in_many_scenes() -> None:
    """The stated errors are those found: 3-D, relative to what was stated, over all scenes."""
    by_frames, by_ball = [], []
    for seed in range(MANY):
        arms, coarse, fine = two_arms(seed, calibrated=True)
        frames_mm, met_mm = mean_miss_mm(arms.coarse_misses(coarse)), arms.fine_misses(fine)
        assert frames_mm <= BY_FRAMES_MM
        assert mean_miss_mm(met_mm) <= BY_BALL_MM
        by_frames.append(frames_mm / coarse.error_mm(REGION_MM))
        by_ball.append(np.sqrt(np.square(met_mm).sum(axis=1).mean()) / fine.meeting_mm)
    assert 0.5 < np.sqrt(np.mean(np.square(by_frames))) < 1.5
    assert 0.7 < np.sqrt(np.mean(np.square(by_ball))) < 1.3


@pytest.fixture(scope="module")
def arms() -> TwoArms:
    return two_arms(0, calibrated=True)[0]


@pytest.fixture(scope="module")
def known(arms: TwoArms) -> BaseToBase:
    """Bases as the tracker would have found them, without its errors."""
    return BaseToBase(arms.base, np.diag([1e-6] * 3 + [0.04] * 3))


@pytest.fixture(scope="module")
def looks(arms: TwoArms) -> BallLooks:
    return arms.ball_looks()


@pytest.fixture(scope="module")
def refined(arms: TwoArms, known: BaseToBase) -> Refine:
    return lambda looks: refine_bases(known, looks, *arms.stated)


def first(looks: BallLooks, count: int) -> BallLooks:
    return BallLooks(*(getattr(looks, field.name)[:count] for field in fields(looks)))


def test_a_spoilt_look_is_left_out(refined: Refine, looks: BallLooks) -> None:
    seen = looks.ball_mm.copy()
    seen[5] += 2.0
    fit = refined(replace(looks, ball_mm=seen))
    assert not fit.used[5]
    assert fit.used.sum() >= looks.count - 3  # one in a thousand sound looks is left out too


def test_many_spoilt_looks_are_refused(refined: Refine, looks: BallLooks) -> None:
    seen = looks.ball_mm.copy()
    seen[::4] += 2.0
    with pytest.raises(DoesNotFit):
        refined(replace(looks, ball_mm=seen))


def test_few_looks_are_refused(refined: Refine, looks: BallLooks) -> None:
    with raises(TOO_FEW_POSES):
        refined(first(looks, 11))


def test_looks_at_a_ball_that_hardly_turns_are_refused(refined: Refine, looks: BallLooks) -> None:
    flanges = looks.base_from_flange.copy()
    flanges[:, :3, :3] = flanges[0, :3, :3]
    with pytest.raises(DegeneratePoses):
        refined(replace(looks, base_from_flange=flanges))


def test_a_ball_that_contradicts_the_tracker_is_refused(
    arms: TwoArms, known: BaseToBase, looks: BallLooks
) -> None:
    elsewhere = known.robot_from_base.copy()
    elsewhere[:3, 3] += 5.0
    with raises(BASES_DISAGREE, match="CAL-022"):
        refine_bases(BaseToBase(elsewhere, known.covariance), looks, *arms.stated)


def test_twelve_looks_predict_where_both_tools_meet_in_other_postures(refined: Refine, arms: TwoArms) -> None:
    """Bases alone leave 0.15 mm: what the arms err differs from posture to posture."""
    fit = refined(first(arms.ball_looks(), 12))
    meets_mm = np.linalg.norm(arms.fine_misses(fit, 20), axis=1)
    assert np.sqrt(np.mean(meets_mm**2)) <= 0.1
    assert fit.error_mm <= BY_BALL_MM
