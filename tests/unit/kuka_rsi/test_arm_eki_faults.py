"""Faults on the EKI channel, and conditions in which the controller must not start, are reported by name."""

from __future__ import annotations

from threading import current_thread
from typing import Any

import pytest
from coded_errors import raises
from driven_arm import activated, configured
from waiting import eventually

from drivers.kuka_rsi.errors import (
    COMMAND_REFUSED,
    CONTROLLER_NOT_READY,
    STREAM_ERRORS,
    UNVERIFIED_CONTROLLER,
    WRONG_CONTROLLER,
)
from drivers.kuka_rsi.fault_watch import FaultWatch
from ronna_hw.arm_stream.mailbox import MailboxTorn
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.errors import PersonNotNamed, WrongState
from ronna_hw.errors import is_error


def test_connect_reports_that_nothing_listens_at_the_address(make_arm: Any) -> None:
    arm = make_arm(eki_port=1)
    with raises(STREAM_ERRORS.not_found, match="refused") as caught:
        arm.connect(timeout_s=1.0)
    assert caught.value.code == "EKI-001"
    assert caught.value.exit_code == 4
    assert arm.state is Lifecycle.DISCONNECTED


def test_connect_reports_that_no_controller_answers_at_the_address(controller: Any, make_arm: Any) -> None:
    controller.mute_commands.add("STATUS")
    with raises(STREAM_ERRORS.not_found, match="no KR C4 answers"):
        make_arm().connect(timeout_s=0.2)


@pytest.mark.parametrize(
    ("fact", "value", "said"),
    [
        ("Cycle", "12", "cycle in ms is 12, not 4"),
        ("Ref", "REL", "corrections is REL, not ABS"),
        ("HoldOn", "0", "HOLDON is False"),
        ("CtxHash", "0123456789abcdef", "context hash is 0123456789abcdef"),
        ("Variant", "kr6_r900_2", "arm is kr6_r900_2, not kr6_r900_sixx"),
    ],
)
@pytest.mark.hazard(20)
def test_a_controller_with_another_configuration_is_refused_at_connect(
    controller: Any, make_arm: Any, fact: str, value: str, said: str
) -> None:
    controller.facts[fact] = value
    arm = make_arm()
    with raises(WRONG_CONTROLLER, match=said) as caught:
        arm.connect()
    assert caught.value.code == "EKI-005"
    assert arm.state is Lifecycle.DISCONNECTED


@pytest.mark.hazard(20)
@pytest.mark.parametrize(("fact", "value"), [("CtxHash", "0123456789abcdef"), ("Variant", "kr6_r900_2")])
def test_recovery_with_another_controller_is_refused(
    controller: Any, active_arm: Any, fact: str, value: str
) -> None:
    controller.drop_eki()
    eventually(lambda: active_arm.state is Lifecycle.FAULT)
    controller.facts[fact] = value
    with raises(WRONG_CONTROLLER, match=value):
        active_arm.recover("tester", 3.0)
    assert active_arm.state is Lifecycle.FAULT
    assert "ACK_ERRORS" not in controller.commands


@pytest.mark.hazard(20)
def test_a_controller_that_does_not_report_its_context_hash_is_unverified(
    controller: Any, make_arm: Any
) -> None:
    del controller.facts["CtxHash"]
    with raises(UNVERIFIED_CONTROLLER, match="context hash") as caught:
        make_arm().connect()
    assert caught.value.code == "EKI-006"


def test_a_controller_that_is_not_ready_is_not_started(controller: Any, make_arm: Any) -> None:
    arm = configured(make_arm())
    controller.facts["Err"] = "29002"
    with raises(CONTROLLER_NOT_READY, match=r"message 29002.*recover\(acknowledged_by\)") as caught:
        arm.activate()
    assert caught.value.code == "EKI-007"
    assert arm.state is Lifecycle.FAULT
    assert not {"RSI_START", "ACK_ERRORS"} & set(controller.commands)
    arm.recover("operator")
    assert controller.facts["Err"] == "0"
    arm.activate()


def test_activate_switches_on_drives_that_are_off(controller: Any, make_arm: Any) -> None:
    controller.facts["Drives"] = "0"
    activated(make_arm())
    assert controller.facts["Drives"] == "1"


def test_a_refused_start_is_reported_with_the_controllers_code(controller: Any, make_arm: Any) -> None:
    controller.ack_codes["RSI_START"] = 5
    arm = configured(make_arm())
    with raises(COMMAND_REFUSED, match="NOT_READY") as caught:
        arm.activate()
    assert caught.value.code == "EKI-008"


@pytest.mark.hazard(4)
def test_a_reader_that_ends_by_any_error_is_a_lost_connection(
    active_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing would hear of an emergency stop."""

    def torn() -> Any:
        raise MailboxTorn("the state row is never consistent")

    check = FaultWatch.check
    monkeypatch.setattr(
        FaultWatch, "check", lambda watch: torn() if current_thread().name == "eki reader" else check(watch)
    )
    eventually(lambda: active_arm.observe().state is Lifecycle.FAULT)
    assert is_error(active_arm.fault, STREAM_ERRORS.lost)
    assert "never consistent" in str(active_arm.fault)
    eventually(lambda: active_arm.connections.link.stop_number > 0)


def test_a_session_that_fell_silent_is_recovered_by_a_new_one(controller: Any, make_arm: Any) -> None:
    arm = configured(make_arm())
    controller.deaf = True
    with raises(STREAM_ERRORS.no_answer):
        arm.activate(timeout_s=0.1)
    assert arm.state is Lifecycle.FAULT
    arm.recover("operator", 3.0)
    arm.activate()


def test_an_unanswered_request_times_out(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    controller.mute_commands.add("STATUS")
    with raises(STREAM_ERRORS.no_answer) as caught:
        arm.read_tool_identity(timeout_s=0.1)
    assert caught.value.code == "EKI-003"


@pytest.mark.slow
def test_rsi_is_stopped_over_eki_when_the_controller_ignores_the_stop_object(
    controller: Any, active_arm: Any
) -> None:
    controller.stop_honoured = False
    active_arm.deactivate(timeout_s=2.0)
    assert "RSI_STOP" in controller.commands
    assert controller.facts["RSI"] == "0"


def test_a_message_from_an_earlier_run_is_acknowledged_only_by_a_named_person(
    controller: Any, make_arm: Any
) -> None:
    controller.facts["Err"] = "29002"
    arm = make_arm()
    arm.connect()
    assert "ACK_ERRORS" not in controller.commands
    with pytest.raises(PersonNotNamed, match="DEV-006"):
        arm.recover("123")
    assert controller.facts["Err"] == "29002"
    arm.recover("operator")
    assert controller.facts["Err"] == "0"
    assert arm.state is Lifecycle.CONNECTED
    with pytest.raises(WrongState):  # nothing is pending any more
        arm.recover("operator")
    arm.configure()
    arm.activate()
    assert arm.state is Lifecycle.ACTIVE
