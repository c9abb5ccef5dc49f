import json
from pathlib import Path

import pytest

from ronna_hw.devices import Lifecycle, LifecycleGuard
from ronna_hw.devices.errors import WrongState
from ronna_hw.errors import LinkTimeout
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
        guard.require("move_joints", [Lifecycle.ACTIVE])


def test_a_fault_can_only_be_left_for_the_connected_state() -> None:
    guard = LifecycleGuard("arm")
    guard.latch(LinkTimeout("silence"))
    with pytest.raises(WrongState):
        guard.enter(Lifecycle.ACTIVE)
    guard.enter(Lifecycle.CONNECTED)
    assert guard.fault is None


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
