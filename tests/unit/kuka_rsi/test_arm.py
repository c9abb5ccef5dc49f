"""The driver against a controller of bytes: sessions from connect to close, and all that goes wrong."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import threading
import time
from itertools import pairwise
from typing import Any

import pytest

from drivers.kuka_rsi.errors import (
    CommandRefused,
    ControllerLost,
    ControllerNotFound,
    ControllerNotReady,
    ControllerRestarted,
    DrivesOff,
    LinkNotStarted,
    LinkProcessDied,
    LinkSilent,
    LinkStopped,
    MotionNotFinished,
    MotionRefused,
    MotionStopped,
    MotionTripped,
    NoAnswer,
    NoTelegram,
    PoseDisagrees,
    ProtectiveStop,
    Unverified,
    WrongController,
)
from ronna_hw.arm.errors import OutOfJointRange
from ronna_hw.arm.kinematics import forward
from ronna_hw.arm.model import arm_model, radians6
from ronna_hw.arm.pose import Pose
from ronna_hw.devices import Lifecycle, RobotArm, StopKind
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import RonnaError

MODEL = arm_model("kr6_r900_sixx")
THERE = radians6(10, -85, 85, 5, 65, -10)
FAR = radians6(60, -60, 60, 30, 80, 90)


def _state(arm: Any) -> Lifecycle:
    state: Lifecycle = arm.state
    return state


def _eventually(condition: Any, limit_s: float = 5.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def _largest_step(replies: list[tuple[int, tuple[float, ...], int]]) -> float:
    """Largest step of a command over the working step of its axis."""
    worst = 0.0
    for (_, a, _), (_, b, _) in pairwise(replies):
        for axis in range(6):
            full = MODEL.full_speed_rad_s[axis] * 57.29578 * 0.004
            worst = max(worst, abs(b[axis] - a[axis]) / full)
    return worst


def test_it_is_a_robot_arm(make_arm: Any) -> None:
    assert isinstance(make_arm(), RobotArm)


def test_a_session_from_connect_to_close(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    identity = arm.connect()
    assert (identity.vendor, identity.model) == ("KUKA", "kr6_r900_sixx")
    assert arm.read_state().commanded_rad is None
    assert arm.read_tool_identity().number == 2
    arm.configure()
    arm.activate()
    assert _state(arm) is Lifecycle.ACTIVE
    reading = arm.move_joints(THERE)
    assert reading.joints_rad == pytest.approx(THERE, abs=4e-6)
    assert reading.commanded_rad == THERE
    assert not reading.moving
    assert reading.validity is Validity.OK
    here = forward(MODEL, THERE)
    target = Pose((here.position_mm[0], here.position_mm[1] + 20, here.position_mm[2]), here.rotation)
    reading = arm.move_linear(target, tool_in_flange_mm=(0.0, 0.0, 100.0))
    assert forward(MODEL, reading.joints_rad).distance_mm(target) < 0.01
    statistics = arm.link_statistics()
    assert statistics.cycles > 100
    assert statistics.lost_cycles == statistics.late_cycles == statistics.rejected_telegrams == 0
    assert sum(statistics.histogram_counts) == statistics.cycles
    assert len(statistics.histogram_edges_us) == len(statistics.histogram_counts) + 1
    assert 0 < statistics.turnaround_median_us <= statistics.turnaround_p99_us
    arm.deactivate()
    assert _state(arm) is Lifecycle.CONFIGURED
    assert controller.facts["RSI"] == "0"
    arm.close()
    assert _state(arm) is Lifecycle.CLOSED
    arm.close()


def test_the_first_correction_is_zero_and_no_step_is_large(controller: Any, active_arm: Any) -> None:
    active_arm.move_joints(THERE)
    assert controller.replies[0][1] == (0.0,) * 6
    assert _largest_step(controller.replies) < 1 / 8


def test_the_stream_can_be_started_again_from_where_the_arm_is(controller: Any, active_arm: Any) -> None:
    active_arm.move_joints(THERE)
    active_arm.deactivate()
    active_arm.activate()
    assert controller.replies[0][1] == (0.0,) * 6
    active_arm.move_joints(radians6(0, -90, 90, 0, 60, 0))
    assert controller.axes_deg == pytest.approx((0, -90, 90, 0, 60, 0), abs=1e-5)


@pytest.mark.slow
def test_no_speed_fraction_goes_beyond_the_working_speed(controller: Any, active_arm: Any) -> None:
    active_arm.move_joints(THERE, speed_fraction=0.2)
    assert _largest_step(controller.replies) < 0.2 / 8 + 1e-4


@pytest.mark.hazard(23)
def test_a_target_out_of_range_is_refused_before_motion(controller: Any, active_arm: Any) -> None:
    with pytest.raises(OutOfJointRange):
        active_arm.move_joints(radians6(0, -90, 90, 0, 130, 0))
    assert _state(active_arm) is Lifecycle.ACTIVE
    assert {r[1] for r in controller.replies} == {(0.0,) * 6}


def test_motion_is_refused_outside_active(make_arm: Any) -> None:
    arm = make_arm()
    with pytest.raises(WrongState):
        arm.move_joints(THERE)
    with pytest.raises(WrongState):
        arm.read_state()


def test_going_nowhere_returns_the_settled_reading(active_arm: Any) -> None:
    here = active_arm.read_state().commanded_rad
    assert active_arm.move_joints(here).commanded_rad == here


# Stops


def _moving(arm: Any, controller: Any) -> tuple[threading.Thread, list[BaseException]]:
    """A long motion in a thread of its own, well under way."""
    controller.pace_s = 0.001
    caught: list[BaseException] = []

    def move() -> None:
        try:
            arm.move_joints(FAR)
        except BaseException as error:
            caught.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    _eventually(lambda: len(controller.replies) > 2 and abs(controller.replies[-1][1][0]) > 2.0)
    return thread, caught


@pytest.mark.hazard(32)
def test_hold_stops_the_arm_smoothly_and_resume_moves_nothing(controller: Any, active_arm: Any) -> None:
    thread, caught = _moving(active_arm, controller)
    active_arm.stop(StopKind.HOLD)
    thread.join()
    assert isinstance(caught[0], MotionStopped)
    assert caught[0].code == "RSI-010"
    assert _state(active_arm) is Lifecycle.HOLD
    with pytest.raises(WrongState):
        active_arm.move_joints(FAR)
    held = active_arm.read_state().commanded_rad
    active_arm.resume()
    assert active_arm.read_state().commanded_rad == held
    active_arm.move_joints(THERE)
    assert _largest_step(controller.replies) < 1 / 8


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        (StopKind.PROTECTIVE, ProtectiveStop),
        pytest.param(StopKind.DRIVES_OFF, DrivesOff, marks=pytest.mark.slow),
        pytest.param(StopKind.LINK, LinkStopped, marks=pytest.mark.slow),
    ],
)
@pytest.mark.hazard(32)
def test_a_stop_that_is_no_hold_is_latched_until_recovered(
    controller: Any, active_arm: Any, kind: StopKind, error: type[RonnaError]
) -> None:
    thread, caught = _moving(active_arm, controller)
    active_arm.stop(kind)
    thread.join()
    assert type(caught[0]) is error
    assert _state(active_arm) is Lifecycle.FAULT
    assert type(active_arm.fault) is error
    assert _largest_step(controller.replies) < 1 / 8
    with pytest.raises(WrongState, match=error.code):  # later calls are refused and name it
        active_arm.read_state()
    if kind is StopKind.DRIVES_OFF:
        assert controller.facts["Drives"] == "0"
    active_arm.recover("operator")
    assert _state(active_arm) is Lifecycle.CONFIGURED
    assert "ACK_ERRORS" in controller.commands
    active_arm.activate()
    active_arm.move_joints(THERE)


@pytest.mark.slow
def test_a_second_motion_while_one_runs_is_refused(controller: Any, active_arm: Any) -> None:
    thread, _ = _moving(active_arm, controller)
    with pytest.raises(MotionRefused, match="another") as refused:
        active_arm.move_joints(THERE)
    assert refused.value.code == "RSI-012"
    active_arm.stop()
    thread.join()


def test_an_arm_that_does_not_settle_is_told_after_its_time_in_cycles(make_arm: Any, controller: Any) -> None:
    arm = make_arm()
    arm.connect()
    arm.configure()
    arm.activate()
    controller.frozen = True
    with pytest.raises(MotionNotFinished) as caught:
        arm.move_joints(radians6(0, -90, 90, 0, 60, 0.5), timeout_s=0.5)
    assert caught.value.code == "RSI-011"


# What goes wrong on the real-time link


@pytest.mark.hazard(38)
def test_an_axis_that_does_not_follow_trips_the_monitor_and_the_cycles_are_kept(
    controller: Any, active_arm: Any
) -> None:
    thread, caught = _moving(active_arm, controller)
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
    assert _largest_step(controller.replies) < 1 / 8


@pytest.mark.hazard(4)
def test_silence_is_noticed_and_latched(controller: Any, active_arm: Any) -> None:
    thread, caught = _moving(active_arm, controller)
    controller.silent.set()
    thread.join()
    assert isinstance(caught[0], LinkSilent)
    assert caught[0].code == "RSI-003"
    assert caught[0].exit_code == 5
    controller.silent.clear()
    last = controller.replies[-1][1]
    count = len(controller.replies)
    _eventually(lambda: len(controller.replies) > count + 5)
    assert {r[1] for r in controller.replies[count:]} == {last}
    active_arm.recover("operator")
    active_arm.activate()
    active_arm.move_joints(THERE)


def test_lost_cycles_are_counted_and_make_the_arm_slower(controller: Any, active_arm: Any) -> None:
    for _ in range(5):
        before = len(controller.replies)
        controller.skip_cycles = 1
        _eventually(lambda before=before: len(controller.replies) > before + 3)
    assert active_arm.link_statistics().lost_cycles == 5
    assert active_arm.link_statistics().late_cycles == 5
    assert active_arm.degraded
    controller.replies.clear()
    active_arm.move_joints(THERE)
    assert _largest_step(controller.replies) < 0.6 / 8


@pytest.mark.hazard(18)
@pytest.mark.slow
def test_one_lost_packet_at_speed_passes_and_the_motion_ends(controller: Any, active_arm: Any) -> None:
    thread, caught = _moving(active_arm, controller)
    controller.skip_cycles = 1
    thread.join()
    assert not caught
    assert _largest_step(controller.replies) < 1 / 8
    assert _state(active_arm) is Lifecycle.ACTIVE


@pytest.mark.hazard(18)
@pytest.mark.slow
def test_after_many_lost_packets_the_arm_goes_on_from_rest(controller: Any, active_arm: Any) -> None:
    thread, caught = _moving(active_arm, controller)
    controller.skip_cycles = 8
    _eventually(lambda: controller.skip_cycles == 0)
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
    _eventually(lambda: _state(active_arm) is Lifecycle.FAULT)
    assert isinstance(active_arm.fault, ControllerRestarted)
    count = len(controller.replies)
    time.sleep(3 * 0.1)
    assert len(controller.replies) == count
    active_arm.recover("operator")
    active_arm.activate()


def test_a_telegram_that_is_none_is_rejected_and_counted(controller: Any, active_arm: Any) -> None:
    controller.junk += [b"\0" * 40, b"<Rob>", b'<!DOCTYPE x><Rob Type="KUKA"></Rob>']
    _eventually(lambda: active_arm.link_statistics().rejected_telegrams >= 3)
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
    os.kill(active_arm._ways.open_link._process.pid, signal.SIGKILL)
    _eventually(lambda: _state(active_arm) is Lifecycle.FAULT)
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
    assert _state(arm) is Lifecycle.CONNECTED
    arm.configure()


def test_no_telegram_after_the_start_is_said_and_latched(controller: Any, make_arm: Any) -> None:
    controller.silent.set()
    arm = make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(NoTelegram) as caught:
        arm.activate(timeout_s=0.5)
    assert caught.value.code == "RSI-002"
    assert _state(arm) is Lifecycle.FAULT
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


# What goes wrong on the EKI channel


def test_nobody_at_the_address_is_told(controller: Any, make_arm: Any) -> None:
    arm = make_arm(eki_port=1)
    with pytest.raises(ControllerNotFound, match="refused") as caught:
        arm.connect(timeout_s=1.0)
    assert caught.value.code == "EKI-001"
    assert caught.value.exit_code == 4
    assert _state(arm) is Lifecycle.DISCONNECTED


def test_somebody_who_does_not_answer_is_no_controller(controller: Any, make_arm: Any) -> None:
    controller.mute_commands.add("STATUS")
    with pytest.raises(ControllerNotFound, match="no KR C4 answers"):
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
def test_a_controller_set_up_otherwise_is_refused_at_connect(
    controller: Any, make_arm: Any, fact: str, value: str, said: str
) -> None:
    controller.facts[fact] = value
    arm = make_arm()
    with pytest.raises(WrongController, match=said) as caught:
        arm.connect()
    assert caught.value.code == "EKI-005"
    assert _state(arm) is Lifecycle.DISCONNECTED


@pytest.mark.hazard(20)
def test_a_controller_that_cannot_say_is_unverified(controller: Any, make_arm: Any) -> None:
    del controller.facts["CtxHash"]
    with pytest.raises(Unverified, match="context hash") as caught:
        make_arm().connect()
    assert caught.value.code == "EKI-006"


def test_a_controller_that_is_not_ready_is_not_started(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    arm.configure()
    controller.facts["Err"] = "29002"
    with pytest.raises(ControllerNotReady, match="message 29002") as caught:
        arm.activate()
    assert caught.value.code == "EKI-007"
    assert _state(arm) is Lifecycle.FAULT
    assert "RSI_START" not in controller.commands
    arm.recover("operator")
    assert controller.facts["Err"] == "0"
    arm.activate()


def test_drives_that_are_off_are_switched_on(controller: Any, make_arm: Any) -> None:
    controller.facts["Drives"] = "0"
    arm = make_arm()
    arm.connect()
    arm.configure()
    arm.activate()
    assert controller.facts["Drives"] == "1"


def test_a_refused_start_is_told_with_the_controllers_code(controller: Any, make_arm: Any) -> None:
    controller.ack_codes["RSI_START"] = 5
    arm = make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(CommandRefused, match="NOT_READY") as caught:
        arm.activate()
    assert caught.value.code == "EKI-008"


def test_a_lost_connection_is_latched_and_recovered_by_a_new_session(
    controller: Any, active_arm: Any
) -> None:
    controller.drop_eki()
    _eventually(lambda: _state(active_arm) is Lifecycle.FAULT)
    with pytest.raises(ControllerLost) as caught:  # the first call that meets a fault is given it
        active_arm.read_state()
    assert caught.value.code == "EKI-002"
    with pytest.raises(WrongState, match="EKI-002"):
        active_arm.read_state()
    active_arm.recover("operator")
    active_arm.activate()
    active_arm.move_joints(THERE)


def test_an_unanswered_question_has_a_time_limit(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    controller.mute_commands.add("STATUS")
    with pytest.raises(NoAnswer) as caught:
        arm.read_tool_identity(timeout_s=0.1)
    assert caught.value.code == "EKI-003"


@pytest.mark.slow
def test_a_controller_that_ignores_the_stop_object_is_ended_by_eki(controller: Any, active_arm: Any) -> None:
    controller.stop_honoured = False
    active_arm.deactivate(timeout_s=2.0)
    assert "RSI_STOP" in controller.commands
    assert controller.facts["RSI"] == "0"


# The end


def test_close_is_bounded_when_the_controller_is_gone(controller: Any, active_arm: Any) -> None:
    controller.silent.set()
    controller.drop_eki()
    begun = time.monotonic()
    active_arm.close()
    assert time.monotonic() - begun < 8.0
    assert _state(active_arm) is Lifecycle.CLOSED


@pytest.mark.slow
def test_close_in_motion_brings_the_arm_to_rest_and_ends_the_program(
    controller: Any, active_arm: Any
) -> None:
    thread, caught = _moving(active_arm, controller)
    active_arm.close()
    thread.join()
    assert caught
    assert controller.facts["RSI"] == "0"
    assert controller.replies[-1][2] == 1
    assert controller.replies[-1][1] == controller.replies[-2][1]
    assert _largest_step(controller.replies) < 1 / 8


def test_close_leaves_no_process(active_arm: Any) -> None:
    pid = active_arm._ways.open_link._process.pid
    active_arm.close()
    assert not os.path.exists(f"/proc/{pid}")


def test_the_real_time_process_imports_nothing_heavy() -> None:
    code = (
        "import sys, drivers.kuka_rsi.link_process\n"
        "heavy = {'scipy', 'cv2', 'pydicom', 'pydantic', 'structlog'} & set(sys.modules)\n"
        "sys.exit(' '.join(sorted(heavy)) or 0)"
    )
    import sys

    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_message_of_an_earlier_run_is_acknowledged_only_by_name(controller: Any, make_arm: Any) -> None:
    controller.facts["Err"] = "29002"
    arm = make_arm()
    arm.connect()
    assert "ACK_ERRORS" not in controller.commands
    with pytest.raises(ValueError, match="name"):
        arm.recover("  ")
    assert controller.facts["Err"] == "29002"
    arm.recover("operator")
    assert controller.facts["Err"] == "0"
    assert _state(arm) is Lifecycle.CONNECTED
    with pytest.raises(WrongState):  # nothing is pending any more
        arm.recover("operator")
    arm.configure()
    arm.activate()
    assert _state(arm) is Lifecycle.ACTIVE


def test_configure_acknowledges_nothing_and_the_error_names_the_call(controller: Any, make_arm: Any) -> None:
    controller.facts["Err"] = "29002"
    arm = make_arm()
    arm.connect()
    arm.configure()
    with pytest.raises(ControllerNotReady, match=r"recover\(acknowledged_by\)"):
        arm.activate()
    assert "ACK_ERRORS" not in controller.commands
    arm.recover("operator")
    arm.activate()
    assert _state(arm) is Lifecycle.ACTIVE
