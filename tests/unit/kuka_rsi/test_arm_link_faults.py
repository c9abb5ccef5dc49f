"""What goes wrong on the real-time link is worked through, or latched and named."""

from __future__ import annotations

import socket
from typing import Any

import pytest
from driven_arm import THERE, largest_step, moving, state_of
from waiting import eventually

from drivers.kuka_rsi.errors import (
    LinkNotStarted,
    LinkSilent,
    MotionTripped,
    NoTelegram,
    PoseDisagrees,
)
from ronna_hw.devices import Lifecycle


@pytest.mark.hazard(38)
def test_an_axis_that_does_not_follow_trips_the_monitor_and_the_cycles_are_kept(
    controller: Any, active_arm: Any
) -> None:
    thread, caught = moving(active_arm, controller)
    controller.frozen = True
    thread.join()
    error = caught[0]
    assert isinstance(error, MotionTripped)
    assert "following error" in str(error)
    cycles = active_arm.recorded_cycles
    assert 10 < len(cycles) <= 256
    assert [c.cycle for c in cycles] == sorted(c.cycle for c in cycles)
    assert cycles[-1].choice == "stop"  # how the stop began is kept as well
    table = error.attachments["flight-record-robot.master.txt"].splitlines()
    assert "following error" in table[0]
    assert table[2].split()[:4] == ["cycle", "IPOC", "ms", "turnaround"]
    assert len(table) > 10 + 3
    assert largest_step(controller.replies) < 1 / 8


@pytest.mark.hazard(4)
def test_silence_is_noticed_and_latched(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    controller.silent.set()
    thread.join()
    assert isinstance(caught[0], LinkSilent)
    assert caught[0].code == "RSI-003"
    assert caught[0].exit_code == 5
    controller.silent.clear()
    last = controller.replies[-1][1]
    count = len(controller.replies)
    eventually(lambda: len(controller.replies) > count + 5)
    assert {r[1] for r in controller.replies[count:]} == {last}
    active_arm.recover("operator")
    active_arm.activate()
    active_arm.move_joints(THERE)


def test_a_taken_port_is_said_at_configure(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(controller.rsi_address)
        with pytest.raises(LinkNotStarted, match="Address already in use") as caught:
            arm.configure()
    assert caught.value.code == "RSI-001"
    assert state_of(arm) is Lifecycle.CONNECTED
    arm.configure()


def test_no_telegram_after_the_start_is_said_and_latched(controller: Any, make_arm: Any) -> None:
    controller.silent.set()
    arm = make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(NoTelegram) as caught:
        arm.activate(timeout_s=0.5)
    assert caught.value.code == "RSI-002"
    assert state_of(arm) is Lifecycle.FAULT
    controller.silent.clear()
    arm.recover("operator")
    arm.activate()


@pytest.mark.hazard(20)
def test_axes_that_disagree_between_the_two_channels_are_refused(controller: Any, make_arm: Any) -> None:
    controller.eki_axes_deg = (5.0, -90.0, 90.0, 0.0, 60.0, 0.0)
    arm = make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(PoseDisagrees, match=r"A1 is 5\.000 deg by EKI") as caught:
        arm.activate()
    assert caught.value.code == "RSI-015"
