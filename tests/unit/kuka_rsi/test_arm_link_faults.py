"""What goes wrong on the real-time link is worked through, or latched and named."""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from itertools import pairwise
from typing import Any

import pytest
from driven_arm import THERE, largest_step, moving, state_of
from waiting import eventually

from drivers.kuka_rsi.errors import (
    ControllerRestarted,
    LinkNotStarted,
    LinkProcessDied,
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


def test_lost_cycles_are_counted_and_make_the_arm_slower(controller: Any, active_arm: Any) -> None:
    for _ in range(5):
        before = len(controller.replies)
        controller.skip_cycles = 1
        eventually(lambda before=before: len(controller.replies) > before + 3)
    assert active_arm.link_statistics().lost_cycles == 5
    assert active_arm.link_statistics().late_cycles == 5
    assert active_arm.degraded
    controller.replies.clear()
    active_arm.move_joints(THERE)
    assert largest_step(controller.replies) < 0.6 / 8


@pytest.mark.hazard(18)
@pytest.mark.slow
def test_one_lost_packet_at_speed_passes_and_the_motion_ends(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    controller.skip_cycles = 1
    thread.join()
    assert not caught
    assert largest_step(controller.replies) < 1 / 8
    assert state_of(active_arm) is Lifecycle.ACTIVE


@pytest.mark.hazard(18)
@pytest.mark.slow
def test_after_many_lost_packets_the_arm_goes_on_from_rest(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    controller.skip_cycles = 8
    eventually(lambda: controller.skip_cycles == 0)
    thread.join()
    assert not caught
    ipocs = [r[0] for r in controller.replies]
    gap = next(k for k, (a, b) in enumerate(pairwise(ipocs)) if b - a > 4)
    before, held, then = (controller.replies[gap + k][1] for k in range(3))
    assert held == before  # the arm stood there already
    assert abs(then[0] - held[0]) < 0.01  # and begins anew slowly
    assert active_arm.degraded


@pytest.mark.hazard(34)
def test_telegrams_of_another_run_get_no_reply(controller: Any, active_arm: Any) -> None:
    controller.new_port = True
    eventually(lambda: state_of(active_arm) is Lifecycle.FAULT)
    assert isinstance(active_arm.fault, ControllerRestarted)
    count = len(controller.replies)
    time.sleep(3 * 0.1)
    assert len(controller.replies) == count
    active_arm.recover("operator")
    active_arm.activate()


def test_a_telegram_that_is_none_is_rejected_and_counted(controller: Any, active_arm: Any) -> None:
    controller.junk += [b"\0" * 40, b"<Rob>", b'<!DOCTYPE x><Rob Type="KUKA"></Rob>']
    eventually(lambda: active_arm.link_statistics().rejected_telegrams >= 3)
    active_arm.move_joints(THERE)


def test_a_stranger_gets_no_reply_and_disturbs_no_motion(controller: Any, active_arm: Any) -> None:
    mover = threading.Thread(target=active_arm.move_joints, args=(THERE,))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.settimeout(0.05)
        mover.start()
        while mover.is_alive():
            stranger.sendto(controller.telegram(), controller.rsi_address)
            mover.join(0.002)
        with pytest.raises(TimeoutError):
            stranger.recv(4096)
    assert active_arm.read_state().joints_rad == pytest.approx(THERE, abs=1e-5)
    assert active_arm.link_statistics().foreign_telegrams > 0


def test_the_link_process_dying_is_noticed(controller: Any, active_arm: Any) -> None:
    os.kill(active_arm._connections.open_link._process.pid, signal.SIGKILL)
    eventually(lambda: state_of(active_arm) is Lifecycle.FAULT)
    assert isinstance(active_arm.fault, LinkProcessDied)
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
