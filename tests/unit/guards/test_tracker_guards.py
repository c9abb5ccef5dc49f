"""A tracker whose replies come late suspends the case while it is needed; a stalling computer does not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import pytest
from room_trials import TrackedCase

from procedures.engine.setting import CaseMemory
from procedures.guards.head_sight import HeadSight
from procedures.guards.tracker_guards import BETWEEN_LOOKS_S, JUDGED, TrackerLink
from ronna_hw.devices import OpticalTracker
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout

pytestmark = pytest.mark.hazard(12)

IN_TIME_S, DELAYED_S = 0.004, 0.5


class Tracker:
    """Each reply takes `reply_s`, and none comes while that is None."""

    def __init__(self) -> None:
        self.state = Lifecycle.ACTIVE
        self.reply_s: float | None = IN_TIME_S
        self.replies_s: tuple[float, ...] = ()
        self.asked = 0

    def read_frame(self) -> None:
        self.asked += 1
        if self.reply_s is None:
            raise LinkTimeout("no reply")
        self.replies_s = (*self.replies_s[-2 * JUDGED :], self.reply_s)

    def replied(self, times_s: Sequence[float]) -> None:
        for self.reply_s in times_s:
            self.read_frame()
        self.asked = 0

    @contextmanager
    def active(self) -> Iterator[Tracker]:
        before, self.state = self.state, Lifecycle.ACTIVE
        yield self
        self.state = before


class Bench:
    """The guard of a case in which a guide approaches the head, or not."""

    def __init__(self) -> None:
        self.tracker, self.memory, self.time_s = Tracker(), CaseMemory(), 0.0
        tracker = cast("OpticalTracker", self.tracker)
        self.guard = TrackerLink(tracker, self.memory, lambda: self.time_s)

    def approach(self) -> HeadSight:
        room = TrackedCase(0).begin()
        room.head_sight.under_way = True
        self.memory.keep(room)
        return room.head_sight


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_a_tracker_that_replies_late_suspends_the_case_until_it_replies_in_time_again(bench: Bench) -> None:
    bench.tracker.replied([IN_TIME_S] * 20 + [DELAYED_S] * 2)
    assert bench.guard.unmet() is None
    bench.tracker.replied([DELAYED_S])
    reason = bench.guard.unmet()
    assert reason is not None
    assert "0.50 s, limit 0.1 s" in reason
    assert "check its cable" in reason
    assert bench.tracker.asked == 1  # one late reply says enough
    bench.tracker.reply_s = IN_TIME_S
    assert bench.guard.unmet() is not None  # it does not ask a slow tracker all the time
    assert bench.tracker.asked == 1
    bench.time_s += BETWEEN_LOOKS_S
    assert bench.guard.unmet() is None
    assert bench.tracker.asked == 1 + JUDGED


@pytest.mark.parametrize(
    "replies_s",
    [
        pytest.param([1.0], id="the first of a run of tracking"),
        pytest.param([IN_TIME_S, 0.3, IN_TIME_S, IN_TIME_S, 0.3] * 4, id="a computer that stalls"),
        pytest.param([0.08] * 20, id="a computer that stalls all the time"),
    ],
)
def test_single_late_replies_are_no_alarm(bench: Bench, replies_s: Sequence[float]) -> None:
    for reply_s in replies_s:
        bench.tracker.replied([reply_s])
        assert bench.guard.unmet() is None
    assert bench.tracker.asked == 0


def test_a_tracker_that_is_not_in_use_is_judged_only_while_a_guide_approaches_the_head(bench: Bench) -> None:
    bench.tracker.replied([DELAYED_S] * JUDGED)
    bench.tracker.state = Lifecycle.CONFIGURED
    assert bench.guard.unmet() is None
    approach = bench.approach()
    assert bench.guard.unmet() is not None
    assert bench.tracker.state is Lifecycle.CONFIGURED
    approach.under_way = False  # nothing holds up the way out
    assert bench.guard.unmet() is None


def test_a_tracker_that_stays_silent_when_it_is_asked_again_is_still_late(bench: Bench) -> None:
    bench.tracker.replied([DELAYED_S] * JUDGED)
    bench.tracker.reply_s = None
    assert bench.guard.unmet() is not None
    bench.tracker.state = Lifecycle.FAULT  # whatever reads it next says why
    assert bench.guard.unmet() is None


def test_a_driver_that_does_not_report_its_replies_is_not_judged(bench: Bench) -> None:
    silent: Any = type("Untimed", (), {"state": Lifecycle.ACTIVE})()
    assert TrackerLink(silent, bench.memory, lambda: 0.0).unmet() is None
