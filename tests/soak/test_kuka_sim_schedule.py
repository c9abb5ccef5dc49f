"""The controller's own timing in real time, which only a quiet machine can show."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from statistics import median

import pytest
from kuka_clients import Cell

pytestmark = pytest.mark.soak


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.mark.parametrize("cycle_ms", [4, 12])
def test_telegrams_leave_on_an_absolute_schedule(stack: ExitStack, cycle_ms: int) -> None:
    rsi = Cell(stack, "--autostart", "--cycle-ms", str(cycle_ms)).rsi
    rsi.cycles(20)
    moments_s, first = [], rsi.ipoc
    for _ in range(1000):
        rsi.receive()
        moments_s.append(time.monotonic())
        rsi.answer()
    assert rsi.ipoc - first == 1000 * cycle_ms
    periods_s = [b - a for a, b in pairwise(moments_s)]
    assert median(periods_s) == pytest.approx(cycle_ms / 1000, rel=0.01)
