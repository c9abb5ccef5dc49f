"""An RSI run, cycle by cycle, without sockets: its cycles, the arm's response, stop inputs, a restart."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from shared_controller import on_a1

from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import ProState, RsiState


def test_ipoc_advances_by_the_cycle_time_and_a_new_run_starts_at_another_value(
    make_bench: Callable[..., Any],
) -> None:
    bench = make_bench()
    run = bench.controller.run
    first = run.ipoc
    for n in range(1, 20):
        bench.answer()
        assert run.ipoc == first + 4 * n
    bench.controller.cancel()
    bench.controller.start()
    assert bench.controller.run.ipoc != run.ipoc
    assert bench.controller.run.ipoc % 4 == 0


def test_corrections_move_the_arm_in_movecorr_and_show_in_aipos(bench: Any) -> None:
    assert bench.controller.rsi_state is RsiState.ON
    bench.enter_movecorr()
    assert bench.controller.rsi_state is RsiState.MOVECORR
    assert bench.controller.program_state is ProState.ACTIVE
    bench.ramp(on_a1(10.0))
    bench.rest(on_a1(10.0))
    assert bench.A1_deg == 10.0
    assert b'<AIPos A1="10.0000"' in bench.telegram()


def test_the_arm_responds_after_the_dead_time_with_a_first_order_lag(bench: Any) -> None:
    bench.enter_movecorr()
    seen = []
    for _ in range(40):
        bench.answer(on_a1(0.1))
        seen.append(bench.A1_deg)
    assert seen[:2] == [0.0, 0.0]
    assert 0.0 < seen[2] < 0.1
    assert seen[5] == pytest.approx(0.1 * (1 - 2.718281828 ** (-4 * 4 / 15)), rel=1e-6)
    assert seen[-1] == 0.1


def test_a_rising_stop_input_ends_the_run(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(3.0))
    bench.answer(on_a1(3.0), stop=1)
    assert bench.controller.run is None
    assert bench.controller.rsi_state is RsiState.IDLE
    assert bench.controller.program_state is ProState.END
    while bench.controller.moving:
        bench.controller.settle()
    assert bench.A1_deg == 3.0


def test_stop_before_movecorr_raises_an_object_error(bench: Any) -> None:
    bench.answer(stop=1)
    assert bench.message_number == 29002


def test_a_stop_object_set_to_info_message_only_notifies_and_the_motion_continues(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = make_bench(context_with(stop={"mode": "InfoMessage"}))
    bench.enter_movecorr()
    bench.ramp(on_a1(3.0))
    bench.answer(on_a1(3.0), stop=1)
    assert bench.controller.run.notice == "STOP1: stop requested"
    bench.ramp(on_a1(4.0), from_deg=on_a1(3.0))
    bench.rest(on_a1(4.0))
    assert bench.A1_deg == 4.0


def test_a_path_stop_brakes_the_arm_while_the_run_streams_and_path_fast_stops_shorter(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    ways = {}
    for mode in ("PathNormal", "Velocity", "PathFast"):
        bench = make_bench(context_with(stop={"mode": mode}))
        bench.enter_movecorr()
        bench.ramp(on_a1(8.0), steps=60)
        before = bench.A1_deg
        bench.answer(on_a1(8.13), stop=1)
        for n in range(100):
            bench.answer(on_a1(8.13 + 0.13 * n), stop=1)
        ways[mode] = bench.A1_deg - before
        assert not bench.controller.moving
        assert bench.controller.rsi_state is RsiState.ON
        assert bench.controller.program_state is ProState.STOP
        assert bench.controller.message is None
    assert 0.0 < ways["PathFast"] < ways["PathNormal"] == ways["Velocity"] < 2.0


def test_a_restarted_run_uses_the_current_arm_position_as_its_base(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(7.0))
    bench.rest(on_a1(7.0))
    bench.answer(on_a1(7.0), stop=1)
    bench.controller.start()
    assert b'A1="7.0000"' in bench.telegram()
    bench.enter_movecorr()
    assert bench.A1_deg == 7.0
    bench.ramp(on_a1(-7.0))
    bench.rest(on_a1(-7.0))
    assert bench.A1_deg == 0.0
