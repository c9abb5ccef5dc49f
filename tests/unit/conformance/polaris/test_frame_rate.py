"""Case P27 on units of several frame rates, at the level of single frames."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import cast

import pytest

from conformance.case import Nonconformity, NotShown
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris import frame_cases

Counter = Callable[[], int]


def _free_running(rate_hz: float) -> Counter:
    began_s = time.monotonic()
    return lambda: int((time.monotonic() - began_s) * rate_hz)


def _keeps_waiting(rate_hz: float) -> Counter:
    """Each request waits for the next frame."""
    began_s, last = time.monotonic(), 0

    def number() -> int:
        nonlocal last
        last = int((time.monotonic() - began_s) * rate_hz) + 1
        time.sleep(max(0.0, began_s + last / rate_hz - time.monotonic()))
        return last

    return number


def _counts_requests() -> Counter:
    return itertools.count(1).__next__


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> Callable[[Counter, bool], None]:
    def run(counter: Counter, clock_known: bool) -> None:
        monkeypatch.setattr(frame_cases, "tracking", lambda _dut: nullcontext())
        monkeypatch.setattr(frame_cases, "frame_number", lambda _unit: counter())
        frame_cases.frame_rate(cast(DeviceUnderTest, SimpleNamespace(clock_known=clock_known)))

    return run


def test_a_unit_at_60_frames_per_second_passes(judge: Callable[[Counter, bool], None]) -> None:
    judge(_free_running(60.0), False)


@pytest.mark.parametrize(
    ("counter", "clock_known"),
    [
        (lambda: _free_running(1.0), False),
        (lambda: _free_running(2.0), False),
        (lambda: _free_running(30.0), False),
        (lambda: _free_running(120.0), True),
        (lambda: _keeps_waiting(20.0), False),
        (lambda: itertools.repeat(7).__next__, True),
    ],
)
def test_a_unit_at_another_rate_fails(
    judge: Callable[[Counter, bool], None], counter: Callable[[], Counter], clock_known: bool
) -> None:
    with pytest.raises(Nonconformity, match="frames"):
        judge(counter(), clock_known)


def test_a_unit_that_counts_requests_is_undecided_only_when_its_clock_is_unknown(
    judge: Callable[[Counter, bool], None],
) -> None:
    with pytest.raises(NotShown, match="--config"):
        judge(_counts_requests(), False)
    with pytest.raises(Nonconformity, match="frames"):
        judge(_counts_requests(), True)
