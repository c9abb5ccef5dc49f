"""How long replies take, which says how old a frame is when it arrives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from polaris_unit_in_process import bring_up

from drivers.ndi_polaris import PolarisTracker


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
