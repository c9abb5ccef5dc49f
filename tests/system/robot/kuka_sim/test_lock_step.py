"""The controller in a theatre whose time waits for the client."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from kuka_clients import LIMIT_S, Cell

from sim.kuka.cycle_loop import REST_CYCLE_S
from sim.world.world import World


def test_lock_step_counts_cycles_and_not_host_time(cell: Callable[..., Cell], lock_step_world: World) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(5)
    before_s = lock_step_world.clock.now_s()
    rsi.move((5.0, 0.0, 0.0, 0.0, 0.0, 0.0), cycles=1000)
    passed_s = lock_step_world.clock.now_s() - before_s
    assert passed_s == pytest.approx(4.0, abs=0.009)
    assert rsi.late == 0
    # A reply that takes the host longer than many cycles is awaited and not late.
    rsi.receive()
    time.sleep(0.05)
    rsi.answer((5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    rsi.cycles(3, (5.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert rsi.late == 0


def test_lock_step_waits_for_a_silent_client_and_then_runs_the_cycles_to_the_timeout(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(10)
    before_s, began_s = lock_step_world.clock.now_s(), time.monotonic()
    state = eki.until(lambda element: element.get("RSI") == "3")
    assert state.get("Err") == "29002"
    assert time.monotonic() - began_s >= 2.0
    assert lock_step_world.clock.now_s() - before_s == pytest.approx(0.4, abs=0.02)


def test_an_idle_world_rests_whatever_its_client_does_until_somebody_waits(
    cell: Callable[..., Cell], lock_step_world: World
) -> None:
    here = cell(world=lock_step_world)
    clock = lock_step_world.clock
    eki, rsi = here.project(), here.rsi
    here.start(eki)
    rsi.cycles(20)
    before_s, began_s = clock.now_s(), time.monotonic()
    rsi.cycles(8)
    assert (clock.now_s() - before_s) < 0.2 * (time.monotonic() - began_s)
    clock.let_pass(1.0)
    began_s = time.monotonic()
    rsi.cycles(250)
    assert time.monotonic() - began_s < 250 * REST_CYCLE_S / 2.0
    assert clock.is_streaming()
    assert eki.command("RSI_STOP") == 0
    deadline = time.monotonic() + LIMIT_S
    while clock.is_streaming() and time.monotonic() < deadline:
        eki.state(RSI="0", Moving="0")
    assert not clock.is_streaming()
