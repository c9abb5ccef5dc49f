"""Frame numbers give the unit's clock despite varying delays, and replies are timed."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from polaris_unit_in_process import bring_up

from drivers.ndi_polaris import PolarisTracker
from drivers.ndi_polaris.tracking import FRAME_NUMBERS, NOMINAL_PERIOD_S, FrameClock, unwrap_frame_number

LEAST_DELAY_S = 0.004
TRUE_PERIOD_S = 1 / 60 * (1 + 40e-6)  # a slow quartz
BEGAN_S = 1234.5


def delays(seed: int) -> Iterator[float]:
    """Draw delays: mostly a little over the least; sometimes the computer stalls for tens of milliseconds."""
    chosen = random.Random(seed)
    while True:
        stall_s = chosen.uniform(0.01, 0.3) if chosen.random() < 0.05 else 0.0
        yield LEAST_DELAY_S + chosen.expovariate(1 / 0.0005) + stall_s


def made_s(count: int) -> float:
    return BEGAN_S + count * TRUE_PERIOD_S


def test_the_fit_recovers_drift_and_measurement_time_despite_jitter_and_stalls() -> None:
    clock = FrameClock()
    errors_s = []
    for count, delay_s in zip(range(60 * 90), delays(1), strict=False):
        fitted_s = clock.add_reply(count, made_s(count) + delay_s)
        errors_s.append(fitted_s - made_s(count) - LEAST_DELAY_S)
    assert max(abs(error_s) for error_s in errors_s[60 * 30 :]) < 0.0005
    assert clock.period_s / NOMINAL_PERIOD_S - 1.0 == pytest.approx(40e-6, abs=5e-6)


def test_no_measurement_time_is_later_than_the_arrival() -> None:
    clock = FrameClock()
    for count, delay_s in zip(range(60 * 20), delays(2), strict=False):
        arrived_s = made_s(count) + delay_s
        assert clock.add_reply(count, arrived_s) <= arrived_s + 1e-9


def test_polling_faster_than_the_unit_measures_does_not_shift_the_fit() -> None:
    clock = FrameClock()
    for count in range(120):
        for again in range(20):
            fitted_s = clock.add_reply(count, made_s(count) + LEAST_DELAY_S + again * 0.0008)
    assert fitted_s == pytest.approx(made_s(119) + LEAST_DELAY_S, abs=1e-4)


def test_a_frame_counter_that_jumps_starts_a_new_fit() -> None:
    clock = FrameClock()
    for count in range(600):
        clock.add_reply(count, made_s(count))
    jumped = 600 + 100_000
    assert clock.add_reply(jumped, made_s(600)) == pytest.approx(made_s(600))
    assert clock.add_reply(jumped + 1, made_s(601) + 0.05) == pytest.approx(made_s(601), abs=1e-4)


def test_an_implausible_frame_rate_is_rejected() -> None:
    clock = FrameClock()
    for count in range(60 * 30):
        clock.add_reply(count, count / 50)
    assert clock.period_s == NOMINAL_PERIOD_S


@pytest.mark.parametrize(
    ("number", "last", "count"),
    [
        (7, None, 7),
        (7, 6, 7),
        (6, 7, 6),
        (2, FRAME_NUMBERS - 1, FRAME_NUMBERS + 2),
        (FRAME_NUMBERS - 1, FRAME_NUMBERS + 2, FRAME_NUMBERS - 1),
        (0, 3 * FRAME_NUMBERS + 5, 3 * FRAME_NUMBERS),
    ],
)
def test_frame_numbers_are_extended_across_their_wrap(number: int, last: int | None, count: int) -> None:
    assert unwrap_frame_number(number, last) == count


def test_readings_carry_the_units_clock_theatre_time_and_measurement_time(
    tracker: PolarisTracker, clock: Any
) -> None:
    stamps = []
    for count in range(200):
        clock.time_s = 50.0 + count / 60 + (0.003 if count % 7 else 0.001)
        stamps.append(tracker.read_frame().stamp)
    assert [stamp.device_clock for stamp in stamps] == list(range(200))
    assert stamps[-1].theatre_time_s == clock.time_s
    assert stamps[-1].measured_s == pytest.approx(50.0 + 199 / 60 + 0.001, abs=1e-6)


def test_tracking_continues_when_the_frame_number_wraps(tracker: PolarisTracker, unit: Any) -> None:
    unit.frame = FRAME_NUMBERS - 3  # 2.3 years later
    usual = unit.usual("BX")

    def wrapping(argument: str) -> bytes:
        if unit.frame == FRAME_NUMBERS - 1:
            unit.frame = -1
        return bytes(usual(argument))

    unit.override("BX", wrapping)
    numbers = [tracker.read_frame().stamp.device_clock for _ in range(5)]
    assert numbers == list(range(FRAME_NUMBERS - 2, FRAME_NUMBERS + 3))


def test_a_new_run_of_tracking_starts_a_new_fit(tracker: PolarisTracker, clock: Any) -> None:
    tracker.read_frame()
    tracker.deactivate()
    clock.time_s = 100.0
    tracker.activate()
    assert tracker.read_frame().stamp.measured_s == 100.0


def test_the_time_of_a_reply_is_reported_without_its_transfer(
    make_tracker: Callable[..., PolarisTracker], unit: Any, clock: Any
) -> None:
    clock.now_s = lambda: unit.now_s
    unit.strays = [(10.0 * k, 0.0, -1500.0) for k in range(20)]
    tracker = bring_up(make_tracker(maximum_baud=9600))

    def delivered_after(delay_s: float) -> tuple[float, ...]:
        unit.deliver = lambda name, reply: [(delay_s + 10 * (len(reply) + 12) / 9600, reply)]
        before_s = unit.now_s
        tracker.read_frame()
        assert unit.now_s - before_s > 0.3 + delay_s  # on the line
        return tracker.replies_s

    assert delivered_after(0.004) == pytest.approx([0.004], abs=0.01)
    assert delivered_after(0.5) == pytest.approx([0.004, 0.5], abs=0.01)
    tracker.deactivate()
    tracker.activate()
    assert len(tracker.replies_s) == 2


def test_a_reply_is_late_only_by_both_clocks(tracker: PolarisTracker, unit: Any, clock: Any) -> None:
    unit.deliver = lambda name, reply: [(0.5, reply)]  # a computer that stalls in lock-step
    tracker.read_frame()

    def hurried(name: str, reply: bytes) -> list[tuple[float, bytes]]:
        clock.time_s += 30.0  # a theatre whose time runs ahead
        return [(0.001, reply)]

    unit.deliver = hurried
    tracker.read_frame()
    assert max(tracker.replies_s) < 0.01


def test_a_reply_that_had_to_be_requested_again_counts_alone(
    tracker: PolarisTracker, unit: Any, clock: Any
) -> None:
    clock.now_s = lambda: unit.now_s
    usual = unit.deliver

    def lost_once(name: str, reply: bytes) -> list[tuple[float, bytes]]:
        unit.deliver = usual
        return []

    unit.deliver = lost_once
    tracker.read_frame(10.0)
    assert tracker.replies_s == pytest.approx([0.001], abs=0.01)
