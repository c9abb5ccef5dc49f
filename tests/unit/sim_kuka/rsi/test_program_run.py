"""An RSI run, cycle by cycle, without sockets: HOLDON, late replies, limits, monitors, faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import ProState, RsiState
from sim.kuka.controller_parameters import ControllerParameters

A1_FULL_STEP_DEG = 360.0 * 0.004
QUARTER_DEG = A1_FULL_STEP_DEG / 4


def on_a1(value: float) -> tuple[float, ...]:
    return (value, 0.0, 0.0, 0.0, 0.0, 0.0)


def axis_of(bench: Any, axis: int = 0) -> float:
    return float(bench.controller.arm.axes_deg[axis])


def message_of(bench: Any) -> int:
    assert bench.controller.message is not None
    return int(bench.controller.message.number)


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
    assert axis_of(bench) == 10.0
    assert b'<AIPos A1="10.0000"' in bench.telegram()


def test_the_arm_responds_after_the_dead_time_with_a_first_order_lag(bench: Any) -> None:
    bench.enter_movecorr()
    seen = []
    for _ in range(40):
        bench.answer(on_a1(0.1))
        seen.append(axis_of(bench))
    assert seen[:2] == [0.0, 0.0]
    assert 0.0 < seen[2] < 0.1
    assert seen[5] == pytest.approx(0.1 * (1 - 2.718281828 ** (-4 * 4 / 15)), rel=1e-6)
    assert seen[-1] == 0.1


def test_a_lost_reply_freezes_the_arm_with_holdon_1(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(5.0))
    bench.rest(on_a1(5.0))
    bench.miss(20)
    assert axis_of(bench) == 5.0
    assert bench.controller.run.late == 20
    assert b'<Delay D="20"/>' in bench.telegram()


def test_a_lost_reply_with_holdon_0_commands_a_jump_back_and_ends_in_a_fault(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    context = context_with()
    receive = tuple(element.model_copy(update={"holdon": 0}) for element in context.receive)
    bench = make_bench(context.model_copy(update={"receive": receive}))
    assert not bench.controller.holds_corrections
    bench.enter_movecorr()
    bench.ramp(on_a1(5.0))
    bench.rest(on_a1(5.0))
    bench.miss()
    assert bench.controller.rsi_state is RsiState.FAULT
    assert message_of(bench) == 1074


def test_relative_corrections_integrate_and_continue_while_replies_are_missing(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = make_bench(context_with(program={"corrections": "relative"}))
    bench.enter_movecorr()
    for _ in range(50):
        bench.answer(on_a1(0.02))
    bench.rest()
    assert axis_of(bench) == pytest.approx(1.0)
    bench.answer(on_a1(0.02))
    bench.miss(9)
    bench.rest()
    assert axis_of(bench) == pytest.approx(1.2)


@pytest.mark.parametrize(("counting", "ends"), [("consecutive", False), ("total", True)])
def test_the_timeout_counts_late_replies_consecutively_or_in_total(
    make_bench: Callable[..., Any], counting: Any, ends: bool
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
        assert message_of(bench) == 29002
        assert bench.controller.drives_on


def test_silence_ends_the_run_at_the_timeout_and_needs_acknowledgement(bench: Any) -> None:
    bench.enter_movecorr()
    bench.miss(99)
    assert bench.controller.run is not None
    bench.miss()
    assert bench.controller.run is None
    assert bench.controller.rsi_state is RsiState.FAULT
    assert bench.controller.start().code == 1
    assert bench.controller.acknowledge().code == 0
    assert bench.controller.start().code == 0


@pytest.mark.parametrize("stamp", [0, -4, 4, 1 << 40])
def test_a_reply_for_another_cycle_is_rejected(bench: Any, stamp: int) -> None:
    run = bench.controller.run
    ipoc = run.ipoc + stamp if stamp else run.ipoc
    data = f'<Sen Type="KROSHU"><IPOC>{max(0, ipoc)}</IPOC></Sen>'.encode()
    assert (run.read(data) is not None) is (stamp == 0)


def test_a_lost_reply_at_an_eighth_of_full_speed_causes_no_fault(bench: Any) -> None:
    bench.enter_movecorr()
    step = A1_FULL_STEP_DEG / 8
    value = 0.0
    for n in range(60):
        value += step
        if n % 10 == 9:
            bench.miss()
        else:
            bench.answer(on_a1(value))
    assert bench.controller.message is None


def test_a_step_above_a_quarter_of_full_speed_stops_the_drives_and_moves_nothing(bench: Any) -> None:
    bench.enter_movecorr()
    bench.answer(on_a1(QUARTER_DEG + 0.001))
    assert message_of(bench) == 1074
    assert not bench.controller.drives_on
    assert bench.controller.run is None
    assert axis_of(bench) == 0.0


def test_a_jump_of_the_correction_at_speed_ends_in_a_braked_stop(bench: Any) -> None:
    bench.enter_movecorr()
    value = 0.0
    for _ in range(50):
        value += 0.15
        bench.answer(on_a1(value))
    bench.answer(on_a1(value + 30.0))
    assert message_of(bench) == 1074
    before, previous_step = axis_of(bench), 0.15
    while bench.controller.moving:
        bench.controller.settle()
        step = axis_of(bench) - before
        assert -1e-9 <= step <= previous_step + 1e-9
        before, previous_step = axis_of(bench), step
    assert before < value + 3.0


def test_speed_above_the_axis_limit_for_several_cycles_is_a_fault(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(parameters=ControllerParameters(step_share=2.0, acceleration_share=100.0))
    bench.enter_movecorr()
    for n in range(1, 3):
        bench.answer(on_a1(n * 1.5))
    bench.answer(on_a1(3.0))
    assert bench.controller.message is None  # two fast cycles only
    for n in range(1, 4):
        bench.answer(on_a1(3.0 + n * 1.5))
    assert message_of(bench) == 1102


@pytest.mark.parametrize("cycle_ms", [4, 12])
@pytest.mark.parametrize("axis", range(6))
def test_a_lost_reply_at_working_speed_causes_no_acceleration_fault(
    make_bench: Callable[..., Any], cycle_ms: int, axis: int
) -> None:
    bench = make_bench(start=False)
    bench.controller.switch_drives(True)
    bench.controller.start(cycle_ms=cycle_ms)
    bench.enter_movecorr()
    joint = bench.controller.arm.description.joints[axis]
    step_deg, place = joint.full_speed_deg_s * cycle_ms / 1000 / 8, 0.0
    gain_deg = 0.2 * joint.acceleration_deg_s2 * (cycle_ms / 1000) ** 2  # a fifth of the axis acceleration
    speed = 0.0
    lost = 0
    for cycle in range(400):
        speed = min(step_deg, speed + gain_deg) if cycle < 300 else max(0.0, speed - gain_deg)
        place += speed
        if place > 90.0:
            break
        if speed == step_deg and cycle % 7 == 0:
            bench.miss()
            lost += 1
        else:
            bench.answer((0.0,) * axis + (-place,) + (0.0,) * (5 - axis))
    assert lost
    assert bench.controller.message is None


@pytest.mark.parametrize("lost", [3, 25])
def test_a_motion_resumes_at_speed_after_few_lost_replies_and_faults_after_many(
    make_bench: Callable[..., Any], lost: int
) -> None:
    bench = make_bench(parameters=ControllerParameters(step_share=1.0))
    bench.enter_movecorr()

    def on_a2(value: float) -> tuple[float, ...]:
        return (0.0, value, 0.0, 0.0, 0.0, 0.0)

    place, speed = 0.0, 0.0
    for _ in range(200):
        speed = min(0.15, speed + 0.0013)  # an eighth of full speed, at a fifth of the acceleration
        place -= speed
        bench.answer(on_a2(place))
    bench.miss(lost)
    if lost <= 3:
        for _ in range(100):
            place -= speed
            bench.answer(on_a2(place))
        assert bench.controller.message is None
    else:
        with pytest.raises(AssertionError):
            bench.ramp(on_a2(place - 100 * speed), on_a2(place), steps=100)
        assert message_of(bench) == 1074


def test_sustained_excess_acceleration_is_a_fault_even_if_no_step_is_too_large(bench: Any) -> None:
    bench.enter_movecorr()
    A2_step_deg = 0.24 * 300.0 * 0.004
    with pytest.raises(AssertionError):
        bench.ramp((0.0, 60 * A2_step_deg, 0.0, 0.0, 0.0, 0.0), steps=60)
    assert message_of(bench) == 1074
    assert "deg/s2" in bench.controller.message.text
    assert not bench.controller.drives_on


def test_the_default_context_clamps_at_the_software_end_switches(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(175.0), steps=2000)
    bench.rest(on_a1(175.0))
    assert axis_of(bench) == 170.0
    assert bench.controller.message is None
    assert bench.controller.run.correction_stats == (0b11, 0)


def test_a_context_without_limits_uses_the_narrow_vendor_defaults(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = make_bench(context_with(axis_correction=None, axis_monitor=None))
    bench.enter_movecorr()
    bench.ramp(on_a1(8.0))
    bench.rest(on_a1(8.0))
    assert axis_of(bench) == 5.0


def test_a_monitor_stops_a_correction_that_the_limits_let_pass(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = make_bench(context_with(axis_monitor=None))
    bench.enter_movecorr()
    with pytest.raises(AssertionError):
        bench.ramp(on_a1(8.0))
    assert message_of(bench) == 29000
    assert axis_of(bench) < 6.5


def test_a_rising_stop_input_ends_the_run(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(3.0))
    bench.answer(on_a1(3.0), stop=1)
    assert bench.controller.run is None
    assert bench.controller.rsi_state is RsiState.IDLE
    assert bench.controller.program_state is ProState.END
    while bench.controller.moving:
        bench.controller.settle()
    assert axis_of(bench) == 3.0


def test_stop_before_movecorr_raises_an_object_error(bench: Any) -> None:
    bench.answer(stop=1)
    assert message_of(bench) == 29002


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
    assert axis_of(bench) == 4.0


def test_a_path_stop_brakes_the_arm_while_the_run_streams_and_path_fast_stops_shorter(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    ways = {}
    for mode in ("PathNormal", "Velocity", "PathFast"):
        bench = make_bench(context_with(stop={"mode": mode}))
        bench.enter_movecorr()
        bench.ramp(on_a1(8.0), steps=60)
        before = axis_of(bench)
        bench.answer(on_a1(8.13), stop=1)
        for n in range(100):
            bench.answer(on_a1(8.13 + 0.13 * n), stop=1)
        ways[mode] = axis_of(bench) - before
        assert not bench.controller.moving
        assert bench.controller.rsi_state is RsiState.ON
        assert bench.controller.program_state is ProState.STOP
        assert bench.controller.message is None
    assert 0.0 < ways["PathFast"] < ways["PathNormal"] == ways["Velocity"] < 2.0


def test_only_send_counts_no_late_replies_and_applies_no_corrections(
    make_bench: Callable[..., Any], context_with: Callable[..., RsiContext]
) -> None:
    bench = make_bench(context_with(ethernet={"only_send": True}))
    for n in range(300):
        bench.answer(on_a1(n * 0.01))
    bench.miss(300)
    assert bench.controller.run.late == 0
    assert axis_of(bench) == 0.0


def test_a_restarted_run_uses_the_current_arm_position_as_its_base(bench: Any) -> None:
    bench.enter_movecorr()
    bench.ramp(on_a1(7.0))
    bench.rest(on_a1(7.0))
    bench.answer(on_a1(7.0), stop=1)
    bench.controller.start()
    assert b'A1="7.0000"' in bench.telegram()
    bench.enter_movecorr()
    assert axis_of(bench) == 7.0
    bench.ramp(on_a1(-7.0))
    bench.rest(on_a1(-7.0))
    assert axis_of(bench) == 0.0


def test_a_12_ms_cycle_allows_three_times_the_step(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(start=False)
    bench.controller.switch_drives(True)
    assert bench.controller.start(cycle_ms=12).code == 0
    first = bench.controller.run.ipoc
    bench.enter_movecorr()
    assert bench.controller.run.ipoc == first + 60
    bench.answer(on_a1(3 * QUARTER_DEG))
    assert bench.controller.message is None
    bench.answer(on_a1(6 * QUARTER_DEG + 0.001))
    assert message_of(bench) == 1074


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
    told: list[tuple[str, int]] = []
    data = reply % run.ipoc if b"%d" in reply else reply
    for now_s in (10.0, 10.5, 11.5):
        assert run.read(data) is None
        run.rejected.tell(now_s, lambda why, count: told.append((why, count)))
    run.rejected.tell(20.0, lambda why, count: told.append((why, count)))
    assert [count for _, count in told] == [1, 3]
    assert all(why.startswith(f"reply rejected: {reason}") for why, _ in told)


def test_an_accepted_reply_counts_no_rejection(bench: Any) -> None:
    bench.answer()
    assert bench.controller.run.rejected.count == 0
