"""Key switch, guard, enabling switch and messages: what lets the arm move and what stops it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from shared_controller import on_a1

from ronna_hw.wire.kuka_eki import AckCode, OperationMode, ProState, RsiState
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.pendant import PendantDisplay, rsi_timeout, too_fast


@pytest.fixture
def in_T1(make_bench: Callable[..., Any]) -> Any:
    bench = make_bench(start=False)
    bench.controller.turn_key(OperationMode.T1)
    bench.controller.hold_start_key(True)
    bench.controller.switch_drives(True)
    return bench


def test_an_open_guard_is_ignored_in_t1(in_T1: Any) -> None:
    controller = in_T1.controller
    controller.open_guard(True)
    assert controller.start().code is AckCode.OK
    assert controller.message is None
    controller.cancel()
    controller.turn_key(OperationMode.EXT)
    assert controller.switch_drives(True).code is AckCode.NOT_READY


def test_corrections_wait_for_confirmation_in_t1_but_not_in_ext(in_T1: Any, bench: Any) -> None:
    bench.enter_movecorr()
    assert bench.controller.rsi_state is RsiState.MOVECORR
    in_T1.controller.start()
    for _ in range(50):
        in_T1.answer()
    assert in_T1.controller.rsi_state is RsiState.ON
    assert in_T1.controller.acknowledge().code is AckCode.OK
    in_T1.answer()
    assert in_T1.controller.rsi_state is RsiState.MOVECORR
    in_T1.go(on_a1(2.0))
    assert in_T1.controller.arm.axes_deg[0] == 2.0


def test_releasing_the_start_key_or_the_enabling_switch_stops_the_program(in_T1: Any) -> None:
    controller = in_T1.controller
    controller.start()
    in_T1.answer()
    controller.hold_start_key(False)
    assert controller.program_state is ProState.STOP
    assert controller.message is None
    assert controller.drives_on
    controller.cancel()
    controller.hold_start_key(True)
    assert controller.start().code is AckCode.OK
    controller.hold_enabling_switch(False)
    assert controller.message is not None
    assert not controller.drives_on
    assert controller.switch_drives(True).code is AckCode.NOT_READY
    controller.hold_enabling_switch(True)
    assert controller.acknowledge().code is AckCode.OK
    assert controller.switch_drives(True).code is AckCode.OK
    assert controller.start().code is AckCode.OK


def test_the_first_message_is_kept_until_it_is_acknowledged(bench: Any) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    controller.collide()
    controller.press_emergency_stop(True)
    assert controller.message.number == ControllerParameters().collision_message
    assert controller.rsi_state is RsiState.ON  # it streams on
    assert controller.cancel().code is AckCode.OK
    assert controller.rsi_state is RsiState.FAULT
    controller.press_emergency_stop(False)
    assert controller.acknowledge().code is AckCode.OK
    assert controller.rsi_state is RsiState.IDLE


def test_an_overload_holds_the_arm_without_a_message_until_the_program_is_cancelled(bench: Any) -> None:
    controller = bench.controller
    bench.enter_movecorr()
    bench.ramp(on_a1(2.0), steps=50)
    controller.overload()
    for _ in range(100):
        bench.answer(on_a1(4.0)) if controller.arm.drives.at_rest else bench.answer(on_a1(2.0))
        if controller.arm.drives.at_rest:
            break
    held = controller.arm.axes_deg
    assert controller.open_brakes == 0
    bench.ramp(on_a1(4.0), from_deg=on_a1(2.0))
    assert controller.arm.axes_deg == held
    assert (controller.message, controller.rsi_state) == (None, RsiState.MOVECORR)
    controller.cancel()
    assert controller.start().code is AckCode.OK
    bench.enter_movecorr()
    bench.go(on_a1(1.0))
    assert controller.arm.axes_deg[0] == pytest.approx(held[0] + 1.0)


def test_a_sticking_axis_holds_until_the_command_is_far_enough_ahead(bench: Any) -> None:
    drives = bench.controller.arm.drives
    bench.enter_movecorr()
    drives.stick(frozenset({0}))
    bench.rest((0.04, 0.04, 0.0, 0.0, 0.0, 0.0))
    assert bench.controller.arm.axes_deg[:2] == [0.0, -89.96]
    bench.rest((0.07, 0.04, 0.0, 0.0, 0.0, 0.0))
    assert 0.03 < bench.controller.arm.axes_deg[0] < 0.07
    drives.stick(frozenset())
    bench.rest((0.07, 0.04, 0.0, 0.0, 0.0, 0.0))
    assert bench.controller.arm.axes_deg[0] == 0.07


def test_in_t1_a_correction_faster_than_250_mm_per_second_stops_the_arm(in_T1: Any) -> None:
    controller = in_T1.controller
    controller.start()
    in_T1.enter_movecorr()
    controller.acknowledge()
    in_T1.answer()
    in_T1.ramp(on_a1(3.0), steps=300)  # some 20 mm/s
    assert controller.message is None
    for n in range(200):  # a gentle start to 45 deg/s at more than 400 mm
        if controller.message is None:
            in_T1.answer(on_a1(3.0 + 0.18 * n * min(1.0, n / 60)))
    assert controller.message.number == ControllerParameters().T1_speed_message


def test_messages_texts_and_acknowledgements_are_each_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    display = PendantDisplay(lambda: 12.5)
    silence, speed = rsi_timeout(100), too_fast("A1", 400.0, 360.0)
    for message, notice in (
        (None, ""),
        (silence, ""),
        (silence, "mind the\nhead"),
        (silence, "mind the\nhead"),
        (None, ""),
        (speed, ""),
    ):
        display.update(message, notice)
    assert capsys.readouterr().err.splitlines() == [
        "pendant at 12.500 s: KSS29002 signal flow: object ETHERNET1 returns error RSITimeout (100 packets)",
        "pendant at 12.500 s: mind the head",
        "pendant at 12.500 s: KSS29002 acknowledged",
        "pendant at 12.500 s: KSS01102 command velocity A1: 400.0 deg/s, at most 360.0",
    ]
