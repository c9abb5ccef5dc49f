from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from coded_errors import raises
from ideal_device import IdealDevice

from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle, LifecycleGuard
from ronna_hw.devices.errors import THEATRE_CLOSED, WrongState
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import EXIT_LINK_LOST, DeviceError, LinkTimeout
from ronna_hw.log_output import keep_log


def test_a_device_cannot_become_active_before_it_is_configured() -> None:
    guard = LifecycleGuard("tracker")
    guard.enter(Lifecycle.CONNECTED)
    with pytest.raises(WrongState, match="cannot go from connected to active"):
        guard.enter(Lifecycle.ACTIVE)


def test_a_latched_fault_keeps_its_first_cause_and_names_it() -> None:
    guard = LifecycleGuard("arm")
    guard.latch(LinkTimeout("silence"))
    guard.latch(LinkTimeout("something later"))
    with pytest.raises(WrongState, match="silence"):
        guard.require("move", [Lifecycle.ACTIVE])


def test_a_fault_can_only_be_left_for_the_connected_state() -> None:
    guard = LifecycleGuard("arm")
    guard.latch(LinkTimeout("silence"))
    with pytest.raises(WrongState):
        guard.enter(Lifecycle.ACTIVE)
    guard.enter(Lifecycle.CONNECTED)
    assert guard.fault is None


def test_a_call_refused_for_a_fault_ends_a_command_as_that_fault_does() -> None:
    guard = LifecycleGuard("arm")
    guard.latch(LinkTimeout("silence"))
    with pytest.raises(WrongState) as refused:
        guard.require("read_state", [Lifecycle.ACTIVE])
    assert refused.value.exit_code == EXIT_LINK_LOST


def test_a_recovered_device_is_configured_already_and_says_what_comes_next() -> None:
    guard = LifecycleGuard("arm")
    guard.latch(LinkTimeout("silence"))
    guard.enter(Lifecycle.CONFIGURED)  # as every driver's `recover` does
    with pytest.raises(
        WrongState, match=r"DEV-001: .*got configured\. Once configured, `activate` comes next"
    ):
        guard.require("configure", [Lifecycle.CONNECTED])


def test_the_closed_state_is_final() -> None:
    guard = LifecycleGuard("stereo")
    guard.enter(Lifecycle.CLOSED)
    guard.latch(LinkTimeout("late"))
    assert guard.state is Lifecycle.CLOSED
    with pytest.raises(WrongState):
        guard.enter(Lifecycle.CONNECTED)
    with raises(THEATRE_CLOSED, match="stereo: grab_pair"):
        guard.require("grab_pair", [Lifecycle.ACTIVE])


def test_every_state_change_is_logged_under_the_device_name(tmp_path: Path) -> None:
    guard = LifecycleGuard("robot.master")
    with keep_log(tmp_path):
        guard.enter(Lifecycle.CONNECTED, serial="P9-1")
        guard.latch(LinkTimeout("silence"))
    _, connected, fault = (json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines())
    assert {key: connected[key] for key in ("event", "before", "device", "serial")} == {
        "event": "connected",
        "before": "disconnected",
        "device": "robot.master",
        "serial": "P9-1",
    }
    assert (fault["event"], fault["level"], fault["cause"]) == ("fault", "error", "silence")


class Recorded(IdealDevice):
    """Writes down the calls of its lifecycle; `on_deactivate` happens on leaving."""

    def __init__(self) -> None:
        super().__init__("device", DeviceConfig(driver="test", endpoint="host:"), HostClock(), known=set())
        self.calls: list[str] = []
        self.on_deactivate: Callable[[], None] = lambda: None

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.calls.append("connect")
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Test", "Ideal", "1", "0")

    def configure(self, timeout_s: float = 10.0) -> None:
        self.calls.append("configure")
        super().configure(timeout_s)

    def activate(self, timeout_s: float = 10.0) -> None:
        self.calls.append("activate")
        super().activate(timeout_s)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        self.on_deactivate()
        self.calls.append("deactivate")
        self.guard.enter(Lifecycle.CONFIGURED)


@pytest.fixture
def device() -> Recorded:
    return Recorded()


def test_a_device_is_brought_to_active_from_disconnected_and_from_configured(device: Recorded) -> None:
    with device.active() as active:
        assert active is device
        assert device.state is Lifecycle.ACTIVE
    with device.active():
        pass
    assert device.calls == ["connect", "configure", *2 * ("activate", "deactivate")]


def test_a_nested_block_leaves_the_device_active(device: Recorded) -> None:
    with device.active():
        with device.active():
            pass
        assert device.state is Lifecycle.ACTIVE
    assert device.calls == ["connect", "configure", "activate", "deactivate"]


def test_a_device_in_hold_is_deactivated_and_activated_again(device: Recorded) -> None:
    with device.active():
        device.guard.enter(Lifecycle.HOLD)
        with device.active():
            assert device.state is Lifecycle.ACTIVE
    assert device.calls[2:] == ["activate", "deactivate", "activate", "deactivate"]


def test_a_failure_to_deactivate_does_not_mask_an_error_and_is_raised_when_there_is_none(
    device: Recorded,
) -> None:
    def refuse() -> None:
        raise LinkTimeout("no reply to STOP")

    device.on_deactivate = refuse
    with pytest.raises(ZeroDivisionError) as caught, device.active():
        raise ZeroDivisionError
    assert caught.value.__notes__ == ["device could not be deactivated: no reply to STOP"]
    device.guard.enter(Lifecycle.CONFIGURED)
    with pytest.raises(LinkTimeout), device.active():
        pass


def test_a_second_interrupt_waits_until_the_device_is_inactive(device: Recorded) -> None:
    device.on_deactivate = lambda: signal.raise_signal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), device.active():
        raise KeyboardInterrupt
    assert device.state is Lifecycle.CONFIGURED


def test_a_fault_in_the_block_stays_latched_and_the_next_block_is_refused(device: Recorded) -> None:
    fault = DeviceError("hardware failure")
    with device.active():
        device.guard.latch(fault)
    assert device.calls[-1] == "activate"
    assert device.observe().fault is fault
    with pytest.raises(WrongState, match=r"got fault \(hardware failure"), device.active():
        pass


@pytest.mark.parametrize("state", list(Lifecycle))
def test_a_device_can_be_observed_in_every_state(device: Recorded, state: Lifecycle) -> None:
    device.guard._now = (state, None)
    assert device.observe().state is state
