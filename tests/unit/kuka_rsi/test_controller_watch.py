"""Conditions that only EKI reports, at rest and before the stream: the cause is named, nothing moves."""

from __future__ import annotations

import signal
import threading
from itertools import pairwise
from math import degrees
from typing import Any

import pytest
from coded_errors import raises
from driven_arm import THERE, configured
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi import micro_move
from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.errors import (
    CONTROLLER_NOT_READY,
    HANDSHAKE_FAILED,
    STREAM_ERRORS,
    UNVERIFIED_CONTROLLER,
)
from drivers.kuka_rsi.micro_move import MicroMove
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.devices import ConfirmedStart, JointMove, Lifecycle, OperatingMode
from ronna_hw.devices.errors import PersonNotNamed
from ronna_hw.errors import ErrorCode, RonnaError, is_error

FULL_SPEED_DEG_S = degrees(kr6_r900("kr6_r900_sixx").full_speed_rad_s[0])


@pytest.mark.parametrize("change", [{"EStop": "1"}, {"Guard": "1"}, {"Mode": "AUT"}])
def test_recovery_is_refused_while_the_cause_persists(
    controller: Any, active_arm: Any, change: dict[str, str]
) -> None:
    controller.tell(**change)
    eventually(lambda: bool(active_arm.state is Lifecycle.FAULT))
    with raises(CONTROLLER_NOT_READY):
        active_arm.recover("Ana")
    assert active_arm.state is Lifecycle.FAULT


@pytest.mark.hazard(4)
def test_a_silent_eki_channel_is_latched_without_any_call(controller: Any, active_arm: Any) -> None:
    controller.tells = False
    eventually(lambda: active_arm.observe().state is Lifecycle.FAULT)
    assert is_error(active_arm.fault, STREAM_ERRORS.no_answer)
    assert "is silent" in str(active_arm.fault)
    controller.tells = True
    active_arm.recover("Ana")
    active_arm.activate()


# Operating mode T1


def test_t1_needs_a_persons_confirmation_for_each_start(controller: Any, make_arm: Any) -> None:
    controller.facts["Mode"] = "T1"
    arm = configured(make_arm())
    with raises(CONTROLLER_NOT_READY, match="T1"):
        arm.activate()
    arm.recover("Ana")
    with pytest.raises(PersonNotNamed):
        arm.allow_t1(" ")
    arm.allow_t1("Ana")
    arm.activate()
    arm.deactivate()
    with raises(CONTROLLER_NOT_READY, match="T1"):
        arm.activate()


@pytest.mark.hazard(51)
def test_in_t1_the_pendant_can_start_the_program_and_speed_is_limited_to_a_tenth(
    controller: Any, make_arm: Any
) -> None:
    controller.facts["Mode"] = "T1"
    controller.ack_codes["RSI_START"] = 5
    arm = configured(make_arm())
    arm.allow_t1("Ana")
    assert arm.operating_mode is OperatingMode.REDUCED_SPEED
    assert arm.limits() == arm.limits(OperatingMode.REDUCED_SPEED) != arm.limits(OperatingMode.AUTOMATIC)
    previewed = arm.preview(JointMove(THERE))

    def press_the_start_key() -> None:
        eventually(lambda: "RSI_START" in controller.commands)
        controller.facts["RSI"] = "2"
        controller.streaming.set()

    presser = threading.Thread(target=press_the_start_key)
    presser.start()
    arm.activate()
    presser.join()
    arm.move(JointMove(THERE))
    angles = [reply[1][0] for reply in controller.replies]
    fastest_deg_s = max(abs(b - a) for a, b in pairwise(angles)) / 0.004
    assert 0.0 < fastest_deg_s <= 0.1001 * FULL_SPEED_DEG_S
    assert _moving_s(angles) == pytest.approx(previewed.duration_s, rel=0.02)  # previewed before the start


def _moving_s(angles: list[float]) -> float:
    return sum(a != b for a, b in pairwise(angles)) * 0.004


# A controller that does not say what it runs


@pytest.fixture
def silent_controller(controller: Any) -> Any:
    for fact in ("Ref", "HoldOn", "Cycle", "CtxHash", "Variant"):
        del controller.facts[fact]
    return controller


def _configured(make_arm: Any) -> Any:
    arm = make_arm(accept_unverified=True)
    assert ("verified", "no, it does not report its cycle in ms, corrections, HOLDON, context hash, arm") in (
        arm.connect().details
    )
    arm.configure()
    return arm


@pytest.mark.hazard(20)
def test_an_unverified_controller_is_activated_only_by_a_micro_move_a_person_confirmed(
    silent_controller: Any, make_arm: Any
) -> None:
    arm = _configured(make_arm)
    with raises(UNVERIFIED_CONTROLLER):
        arm.activate()
    with pytest.raises(PersonNotNamed):
        arm.activate_unverified("")
    arm.activate_unverified("Ana")
    assert arm.state is Lifecycle.ACTIVE
    largest = [max(abs(reply[1][axis]) for reply in silent_controller.replies) for axis in range(6)]
    assert all(0.002 < angle <= 0.02 for angle in largest)  # each axis, and none by more
    assert silent_controller.replies[-1][1] == (0.0,) * 6  # and back
    arm.move(JointMove(THERE))


@pytest.mark.hazard(20)
def test_a_confirmed_start_of_an_unverified_controller_is_a_micro_move_and_is_valid_once(
    silent_controller: Any, make_arm: Any
) -> None:
    arm = _configured(make_arm)
    assert isinstance(arm, ConfirmedStart)
    assert "does not report which program it runs" in str(arm.to_confirm)
    arm.confirm_start("Ana")
    arm.activate()
    assert all(any(reply[1][axis] for reply in silent_controller.replies) for axis in range(6))
    arm.deactivate()
    with raises(UNVERIFIED_CONTROLLER):
        arm.activate()


@pytest.mark.hazard(20)
def test_a_confirmation_given_when_none_was_due_does_not_permit_a_start_in_t1(
    controller: Any, make_arm: Any
) -> None:
    arm = configured(make_arm())
    assert arm.to_confirm is None
    arm.confirm_start("Ana")
    controller.tell(Mode="T1")
    with raises(CONTROLLER_NOT_READY, match="T1"):
        arm.activate()


def test_in_t1_a_start_is_confirmed_by_the_person_next_to_the_arm(controller: Any, make_arm: Any) -> None:
    controller.facts["Mode"] = "T1"
    arm = configured(make_arm())
    assert arm.to_confirm == "the controller is in T1: someone holding the pendant is next to the arm"
    arm.confirm_start("Ana")
    arm.activate()
    assert arm.state is Lifecycle.ACTIVE


@pytest.mark.hazard(20)
@pytest.mark.parametrize("how", ["axes exchanged", "corrections add up", "nothing follows"])
def test_a_controller_that_follows_the_micro_move_wrongly_is_refused(
    silent_controller: Any, make_arm: Any, how: str
) -> None:
    before = silent_controller.axes_deg
    silent_controller.pace_s = 0.001
    if how == "axes exchanged":
        silent_controller.order = (1, 0, 2, 3, 4, 5)
    silent_controller.adds_up = how == "corrections add up"
    silent_controller.frozen = how == "nothing follows"
    arm = _configured(make_arm)
    with raises(HANDSHAKE_FAILED):
        arm.activate_unverified("Ana")
    assert arm.state is Lifecycle.FAULT
    assert not silent_controller.streaming.is_set()
    moved = [abs(a - b) for a, b in zip(before, silent_controller.axes_deg, strict=True)]
    assert max(moved) < 5.0  # this machine may stall; on one that does not it is hundredths


def test_a_stop_during_the_micro_move_ends_it(silent_controller: Any, make_arm: Any) -> None:
    silent_controller.pace_s = 0.001
    arm = _configured(make_arm)

    def stop_once_moving() -> None:
        eventually(lambda: any(any(reply[1]) for reply in silent_controller.replies))
        arm.stop()

    stopping = threading.Thread(target=stop_once_moving)
    stopping.start()
    with raises(STREAM_ERRORS.stopped):
        arm.activate_unverified("Ana")
    stopping.join()
    assert not any(reply[1][0] for reply in silent_controller.replies)  # A1 is the last one tested
    assert not silent_controller.streaming.is_set()


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("signalled", "error"), [(signal.SIGKILL, STREAM_ERRORS.died), (signal.SIGSTOP, HANDSHAKE_FAILED)]
)
def test_a_real_time_process_that_fails_during_the_micro_move_ends_it(
    silent_controller: Any,
    make_arm: Any,
    monkeypatch: pytest.MonkeyPatch,
    signalled: signal.Signals,
    error: ErrorCode[RonnaError],
) -> None:
    arm = _configured(make_arm)
    silent_controller.pace_s = 0.001
    require_small = MicroMove._require_small

    def fail_once_moving(test: Any, state: Any, *limits: Any) -> None:
        require_small(test, state, *limits)
        if state.moving:
            test._link.process.send_signal(signalled)
            monkeypatch.setattr(micro_move, "TELEGRAMS_LIMIT_S", 0.5)

    monkeypatch.setattr(MicroMove, "_require_small", fail_once_moving)
    with raises(error):
        arm.activate_unverified("Ana")
    assert arm.fault.code == error.code
    arm.connections.link.process.kill()  # so that closing need not wait for a stopped one
    arm.connections.control.status(HANG_LIMIT_S)  # what it was asked before is answered before it closes


def test_a_stop_during_a_start_leaves_the_arm_in_hold(make_arm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    arm = configured(make_arm())
    start = Connections.start_stream

    def started(*details: Any) -> Any:
        mode = start(*details)
        arm.stop()
        return mode

    monkeypatch.setattr(Connections, "start_stream", started)
    arm.activate()
    assert arm.state is Lifecycle.HOLD


@pytest.mark.hazard(20)
def test_a_wrong_fact_reported_by_an_unverified_controller_is_refused(controller: Any, make_arm: Any) -> None:
    del controller.facts["CtxHash"]
    controller.facts["Variant"] = "kr6_r900_2"
    with pytest.raises(RonnaError, match="arm is kr6_r900_2"):
        make_arm(accept_unverified=True).connect()


def test_close_stops_the_eki_reader_before_closing_the_links_memory(
    active_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = next(thread for thread in threading.enumerate() if thread.name == "eki reader")
    link = active_arm.connections.link
    heard: list[bool] = []
    close = link.close

    def closing() -> None:
        heard.append(reader.is_alive())
        close()

    monkeypatch.setattr(link, "close", closing)
    active_arm.close()
    assert heard == [False]
