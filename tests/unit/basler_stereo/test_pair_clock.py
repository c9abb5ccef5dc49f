"""Pairs are judged by the cameras' own clocks, which have different zeros and drift."""

from __future__ import annotations

import pytest

from drivers.basler_stereo.readings import PairClock, Tie
from ronna_hw.devices.readings import Validity

HZ = 125_000_000
SKEW_S = 0.01


def tied(left_zero: int = 1_000, right_zero: int = 9_000_000_000) -> PairClock:
    return PairClock((Tie(left_zero, HZ, 100.0, 1e-4), Tie(right_zero, HZ, 100.0, 1e-4)), SKEW_S)


def ticks(left_s: float, right_s: float) -> tuple[int, int]:
    return 1_000 + round((left_s - 100.0) * HZ), 9_000_000_000 + round((right_s - 100.0) * HZ)


@pytest.mark.parametrize(
    ("left_s", "right_s", "validity"),
    [
        (101.0, 101.0, Validity.OK),
        (101.0, 101.009, Validity.OK),
        (101.03, 101.0, Validity.UNPAIRED),
        (101.0, 101.03, Validity.UNPAIRED),
        (100.9, 100.9, Validity.STALE),
        (100.9, 101.0, Validity.UNPAIRED),
    ],
)
def test_exposure_moments_decide_the_validity_of_a_pair(left_s, right_s, validity):
    assert tied().judge(ticks(left_s, right_s), 101.0, 101.1) is validity


def test_slow_drift_does_not_accumulate():
    clock = tied()
    for second in range(1, 2000):
        now_s = 100.0 + second
        pair = ticks(now_s, now_s + 1e-4 * second)  # 100 ppm: 0.2 s in the end
        assert clock.judge(pair, now_s, now_s + 0.1) is Validity.OK
        clock.confirm(pair, (HZ, HZ), now_s, now_s + 0.1)


def test_a_restarted_counter_is_detected():
    clock = tied()
    clock.confirm(ticks(101.0, 101.0), (HZ, HZ), 101.0, 101.1)
    assert clock.judge((ticks(102.0, 102.0)[0], 500), 102.0, 102.1) is Validity.UNPAIRED


def test_without_a_latch_the_first_pair_is_accepted_and_the_second_judged():
    clock = PairClock((None, None), SKEW_S)
    assert clock.judge((5, 7_000_000), 100.0, 100.1) is Validity.OK
    clock.confirm((5, 7_000_000), (HZ, HZ), 100.0, 100.1)
    assert clock.judge((5 + HZ, 7_000_000 + HZ), 101.0, 101.1) is Validity.OK
    assert clock.judge((5 + HZ, 7_000_000 + HZ // 2), 101.0, 101.1) is Validity.UNPAIRED


def test_cameras_without_a_clock_are_accepted():
    clock = PairClock((None, None), SKEW_S)
    clock.confirm((1, 2), (0, 0), 100.0, 100.1)
    assert clock.judge((1, 2), 200.0, 200.1) is Validity.OK
