"""Faults on the real-time link are ridden through, or latched and named."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import pytest
from coded_errors import raises
from driven_arm import THERE, configured, largest_step, moving
from waiting import eventually

from drivers.kuka_rsi.errors import NO_TELEGRAM, POSE_DISAGREES, STREAM_ERRORS
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.records import Choice
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove


@pytest.mark.hazard(38)
def test_an_axis_that_does_not_follow_trips_the_monitor_and_the_last_cycles_are_kept(
    controller: Any, active_arm: Any
) -> None:
    thread, caught = moving(active_arm, controller)
    controller.frozen = True
    thread.join()
    error = caught[0]
    assert error.code == STREAM_ERRORS.tripped.code
    assert "following error" in str(error)
    cycles = active_arm.recorded_cycles
    assert 10 < len(cycles) <= 256
    assert [c.cycle for c in cycles] == sorted(c.cycle for c in cycles)
    assert cycles[-1].choice is Choice.STOP  # how the stop began is kept as well
    table = error.attachments["flight-record-robot.master.txt"].splitlines()
    assert "following error" in table[0]
    assert table[2].split()[:4] == ["cycle", "IPOC", "ms", "turnaround"]
    assert len(table) > 10 + 3
    assert largest_step(controller.replies) < 1 / 8


@pytest.mark.hazard(4)
def test_link_silence_is_detected_and_latched(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    controller.silent.set()
    thread.join()
    assert caught[0].code == STREAM_ERRORS.silent.code
    assert caught[0].code == "RSI-003"
    assert caught[0].exit_code == 5
    controller.silent.clear()
    last = controller.replies[-1][1]
    count = len(controller.replies)
    eventually(lambda: len(controller.replies) > count + 5)
    assert {r[1] for r in controller.replies[count:]} == {last}
    active_arm.recover("operator")
    active_arm.activate()
    active_arm.move(JointMove(THERE))


def test_configure_reports_a_port_in_use(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(controller.rsi_address)
        with raises(STREAM_ERRORS.not_started, match="Address already in use") as caught:
            arm.configure()
    assert caught.value.code == "RSI-001"
    assert arm.state is Lifecycle.CONNECTED
    arm.configure()


@pytest.mark.hazard(30)
def test_configure_names_the_signal_that_killed_the_real_time_process(
    make_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(subprocess.Popen[bytes]):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            self.send_signal(signal.SIGKILL)

    arm = make_arm()
    arm.connect()
    monkeypatch.setattr(subprocess, "Popen", Killed)
    with raises(STREAM_ERRORS.not_started, match="killed by SIGKILL") as caught:
        arm.configure()
    assert "port" not in caught.value.advice
    monkeypatch.undo()
    arm.configure()


def test_activate_reports_and_latches_a_missing_first_telegram(controller: Any, make_arm: Any) -> None:
    controller.silent.set()
    arm = configured(make_arm())
    with raises(NO_TELEGRAM) as caught:
        arm.activate(timeout_s=0.5)
    assert caught.value.code == "RSI-002"
    assert arm.state is Lifecycle.FAULT
    controller.silent.clear()
    arm.recover("operator")
    arm.activate()


@pytest.mark.hazard(20)
def test_axes_that_disagree_between_eki_and_rsi_are_refused(controller: Any, make_arm: Any) -> None:
    controller.eki_axes_deg = (5.0, -90.0, 90.0, 0.0, 60.0, 0.0)
    arm = configured(make_arm())
    with raises(POSE_DISAGREES, match=r"A1 is 5\.000 deg by EKI and 0\.000 by RSI") as caught:
        arm.activate(timeout_s=0.5)
    assert caught.value.code == "RSI-015"
    assert controller.replies == []


@pytest.fixture
def waiting_arm(controller: Any, make_arm: Any) -> Iterator[tuple[Any, Future[None]]]:
    """Start an arm that waits for its controller's first telegram; keep the outcome."""
    controller.silent.set()
    arm = configured(make_arm())
    with ThreadPoolExecutor(1) as another:
        activated = another.submit(arm.activate, timeout_s=2.0)
        assert controller.standing.wait(5.0)
        yield arm, activated


def _strangers_say(controller: Any, *datagrams: bytes) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for data in datagrams:
            stranger.sendto(data, controller.rsi_address)
            stranger.settimeout(0.05)
            with pytest.raises(TimeoutError):
                stranger.recv(4096)


def _elsewhere(controller: Any) -> bytes:
    telegram: bytes = controller.telegram().replace(b'A1="0.0000"', b'A1="30.0000"')
    return telegram


@pytest.mark.hazard(20)
def test_foreign_datagrams_before_the_controllers_first_telegram_get_no_reply_and_end_nothing(
    controller: Any, waiting_arm: Any
) -> None:
    arm, activated = waiting_arm
    unknown = b'<?xml version="1.0" encoding="foo"?><Rob Type="KUKA"></Rob>'
    _strangers_say(controller, b"hello", _elsewhere(controller), unknown, b"<Rob", _elsewhere(controller))
    controller.silent.clear()
    activated.result(5.0)
    assert arm.state is Lifecycle.ACTIVE
    assert arm.read_state().joints_rad == radians6(*controller.axes_deg)


def test_foreign_datagrams_are_counted_and_named_when_the_controllers_telegram_does_not_come(
    controller: Any, waiting_arm: Any
) -> None:
    arm, activated = waiting_arm
    _strangers_say(controller, b"hello", _elsewhere(controller), _elsewhere(controller))
    said = "A1 is 0.000 deg by EKI and 30.000 by RSI; 2 reported other axes, 1 were malformed"
    with raises(POSE_DISAGREES, match=re.escape(said) + ".*the last from 127.0.0.1"):
        activated.result(5.0)
    assert arm.state is Lifecycle.FAULT
