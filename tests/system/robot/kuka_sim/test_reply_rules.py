"""The deadline for a reply and which of two counts: what public sources leave open, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from kuka_clients import Cell, RsiClient

CYCLE_S = 0.012
CYCLES = 20
MOST_CYCLES = 80  # fewer than the controller takes for a lost client


def streaming(cell: Callable[..., Cell], window: str) -> RsiClient:
    """A client that has its first telegram, with that share of the cycle to reply."""
    here = cell("--set", f"reply_window={window}")
    eki = here.project()
    assert eki.command("DRIVES", On=1) == 0
    assert eki.command("RSI_START", Cycle=12) == 0
    here.rsi.receive()
    return here.rsi


def cycles_since(first: int, rsi: RsiClient) -> int:
    return (rsi.ipoc - first) // round(CYCLE_S * 1000)


def test_a_reply_after_its_share_of_the_cycle_is_late(cell: Callable[..., Cell]) -> None:
    rsi = streaming(cell, "0.25")
    first = rsi.ipoc
    for _ in range(CYCLES):
        time.sleep(CYCLE_S / 2)  # later than a quarter of the cycle, whatever else the machine does
        rsi.answer()
        rsi.receive()
    # all but those that came while a busy machine held the controller up
    assert rsi.late > cycles_since(first, rsi) // 2


def test_a_reply_within_its_share_of_the_cycle_is_not_late(cell: Callable[..., Cell]) -> None:
    rsi = streaming(cell, "1")
    first = rsi.ipoc
    for _ in range(MOST_CYCLES):
        time.sleep(CYCLE_S / 2)
        rsi.answer()
        rsi.receive_newest()  # a busy machine lets telegrams pile up: only the newest can be answered in time
        if rsi.late < cycles_since(first, rsi):
            return
    pytest.fail(f"{rsi.late} of {cycles_since(first, rsi)} replies were late")
