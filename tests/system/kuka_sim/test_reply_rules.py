"""By when a reply must come and which of two counts: what public sources leave open, in real time."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from kuka_clients import Cell
from kuka_stage import on_a1

CYCLE_S = 0.012
CYCLES = 20
TURN_DEG = 0.05


@pytest.mark.parametrize(("window", "all_late"), [("0.25", True), ("1", False)])
def test_a_reply_must_come_within_its_share_of_the_cycle(
    cell: Callable[..., Cell], window: str, all_late: bool
) -> None:
    here = cell("--set", f"reply_window={window}")
    eki, rsi = here.project(), here.rsi
    assert eki.command("DRIVES", On=1) == 0
    assert eki.command("RSI_START", Cycle=12) == 0
    rsi.receive()
    first = rsi.ipoc
    for _ in range(CYCLES):
        time.sleep(CYCLE_S / 2)  # later than a quarter of the cycle, whatever else the machine does
        rsi.answer()
        rsi.receive()
    cycles = (rsi.ipoc - first) // round(CYCLE_S * 1000)
    assert (rsi.late == cycles) is all_late


@pytest.mark.parametrize(("second", "turns"), [("ignored", False), ("taken", True)])
def test_of_two_replies_the_first_counts_or_the_second(
    cell: Callable[..., Cell], second: str, turns: bool
) -> None:
    rsi = cell("--autostart", "--cycle-ms", "12", "--set", f"second_reply={second}").rsi
    rsi.receive()
    base_deg, furthest_deg = rsi.axes_deg[0], 0.0
    for _ in range(CYCLES):
        rsi.answer()
        rsi.answer(on_a1(TURN_DEG))
        rsi.receive()
        furthest_deg = max(furthest_deg, rsi.axes_deg[0] - base_deg)
    assert (furthest_deg > TURN_DEG / 2) is turns
