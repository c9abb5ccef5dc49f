"""One run of the RSI program: start, corrections, missing and rejected replies, end."""

from __future__ import annotations

from typing import Any

import pytest
from shared_controller import Make, on_a1

from ronna_hw.wire.kuka_eki import ProState, RsiState
from sim.kuka.controller_parameters import ControllerParameters


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
    make_bench: Make, context_with: Make
) -> None:
    bench = make_bench(context_with(stop={"mode": "InfoMessage"}))
    bench.enter_movecorr()
    bench.ramp(on_a1(3.0))
    bench.answer(on_a1(3.0), stop=1)
    assert bench.controller.run.notice == "STOP1: stop requested"
    bench.go(on_a1(4.0), from_deg=on_a1(3.0))
    assert bench.A1_deg == 4.0


def test_a_path_stop_brakes_the_arm_while_the_run_streams_and_path_fast_stops_shorter(
    make_bench: Make, context_with: Make
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


def test_a_lost_reply_with_holdon_0_commands_a_jump_back_and_ends_in_a_fault(
    make_bench: Make, context_with: Make
) -> None:
    context = context_with()
    receive = tuple(element.model_copy(update={"holdon": 0}) for element in context.receive)
    bench = make_bench(context.model_copy(update={"receive": receive}))
    assert not bench.controller.holds_corrections
    bench.enter_movecorr()
    bench.go(on_a1(5.0))
    bench.miss()
    assert bench.controller.rsi_state is RsiState.FAULT
    assert bench.message_number == 1074


def test_relative_corrections_integrate_and_continue_while_replies_are_missing(
    make_bench: Make, context_with: Make
) -> None:
    bench = make_bench(context_with(program={"corrections": "relative"}))
    bench.enter_movecorr()
    for _ in range(50):
        bench.answer(on_a1(0.02))
    bench.rest()
    assert bench.A1_deg == pytest.approx(1.0)
    bench.answer(on_a1(0.02))
    bench.miss(9)
    bench.rest()
    assert bench.A1_deg == pytest.approx(1.2)


@pytest.mark.parametrize(("counting", "ends"), [("consecutive", False), ("total", True)])
def test_the_timeout_counts_late_replies_consecutively_or_in_total(
    make_bench: Make, counting: Any, ends: bool
) -> None:
    bench = make_bench(parameters=ControllerParameters(timeout_counting=counting))
    for _ in range(12):
        if bench.controller.run is None:
            break
        bench.miss(9)
        if bench.controller.run is not None:
            bench.answer()
    assert (bench.controller.run is None) is ends
    if ends:
        assert bench.message_number == 29002
        assert bench.controller.drives_on


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (b'<Sen Type="RONNA"><IPOC>%d</IPOC></Sen>', "Type RONNA, expected KROSHU"),
        (b'<Sen Type="KROSHU"><IPOC>7</IPOC></Sen>', "IPOC 7, expected "),
        (b'<Sen Type="KROSHU"></Sen>', "no IPOC"),
        (b"hello", "no <Sen Type=...>"),
        (b'<Sen Type="KROSHU"><AK A1="0"><IPOC>%d</IPOC></Sen>', "not well-formed XML"),
    ],
)
def test_rejected_replies_are_reported_once_a_second_with_reason_and_count(
    bench: Any, reply: bytes, reason: str
) -> None:
    run = bench.controller.run
    said: list[tuple[str, int]] = []
    data = reply % run.ipoc if b"%d" in reply else reply
    for now_s in (10.0, 10.5, 11.5):
        assert run.read(data) is None
        run.rejected.report(now_s, lambda why, count: said.append((why, count)))
    run.rejected.report(20.0, lambda why, count: said.append((why, count)))
    assert [count for _, count in said] == [1, 3]
    assert all(why.startswith(f"reply rejected: {reason}") for why, _ in said)


def test_only_send_counts_no_late_replies_and_applies_no_corrections(
    make_bench: Make, context_with: Make
) -> None:
    bench = make_bench(context_with(ethernet={"only_send": True}))
    for n in range(300):
        bench.answer(on_a1(n * 0.01))
    bench.miss(300)
    assert bench.controller.run.late == 0
    assert bench.A1_deg == 0.0
