"""Stops of every kind, ordered while the arm moves."""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest
from coded_errors import raises
from driven_arm import FAR, THERE, activated, configured, largest_step, moving
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi.errors import STREAM_ERRORS
from ronna_hw.arguments import WrongArgument
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.motion import MotionFollower
from ronna_hw.arm_stream.records import LinkFault, StopOrder
from ronna_hw.devices import Lifecycle, StopKind
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import LifecycleGuard
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import ErrorCode, RonnaError


@pytest.mark.hazard(32)
def test_hold_stops_the_arm_smoothly_and_resume_causes_no_motion(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    active_arm.stop(StopKind.HOLD)
    thread.join()
    assert caught[0].code == STREAM_ERRORS.stopped.code
    assert caught[0].code == "RSI-010"
    assert active_arm.state is Lifecycle.HOLD
    with pytest.raises(WrongState):
        active_arm.move(JointMove(FAR))
    held = active_arm.read_state().commanded_rad
    active_arm.resume()
    assert active_arm.read_state().commanded_rad == held
    active_arm.move(JointMove(THERE))
    assert largest_step(controller.replies) < 1 / 8


@pytest.mark.hazard(32)
@pytest.mark.parametrize("wrong", [("halt",), (2.0,), (None,), (StopKind.HOLD, -1.0), ("hold", "soon")])
def test_a_stop_with_a_wrong_argument_holds_the_arm_and_says_so_afterwards(
    controller: Any, active_arm: Any, wrong: tuple[Any, ...]
) -> None:
    thread, caught = moving(active_arm, controller)
    with raises(WrongArgument, match="HOLD all the same"):
        active_arm.stop(*wrong)
    thread.join()
    assert caught[0].code == "RSI-010"
    assert active_arm.state is Lifecycle.HOLD


@pytest.mark.hazard(32)
@pytest.mark.parametrize("problem", [KeyboardInterrupt, SystemExit, ZeroDivisionError])
def test_a_motion_that_an_interruption_ends_leaves_the_arm_held(
    controller: Any, active_arm: Any, monkeypatch: pytest.MonkeyPatch, problem: type[BaseException]
) -> None:
    wait = MotionFollower.wait

    def interrupted(self: Any, *condition: Any) -> Any:
        monkeypatch.setattr(MotionFollower, "wait", wait)
        eventually(lambda: abs(controller.replies[-1][1][0]) > 2.0)  # it moves
        raise problem

    controller.pace_s = 0.001
    monkeypatch.setattr(MotionFollower, "wait", interrupted)
    with pytest.raises(problem):
        active_arm.move(JointMove(FAR))
    assert active_arm.state is Lifecycle.HOLD
    eventually(lambda: not active_arm.read_state().moving)
    assert abs(active_arm.read_state().joints_rad[0] - FAR[0]) > 0.01, "it has driven on to its goal"


@pytest.mark.hazard(32)
def test_a_device_is_refused_in_a_forked_process_instead_of_hanging_there(active_arm: Any) -> None:
    reads, writes = os.pipe()
    if (child := os.fork()) == 0:
        said = "stopped"
        try:
            active_arm.stop()
        except RonnaError as error:
            said = error.code
        os.write(writes, said.encode())
        os._exit(0)
    os.waitpid(child, 0)
    assert os.read(reads, 100) == b"DEV-016"
    os.close(reads)
    os.close(writes)


@pytest.mark.hazard(32)
def test_a_stop_by_the_word_of_its_kind_stops(controller: Any, active_arm: Any) -> None:
    thread, caught = moving(active_arm, controller)
    active_arm.stop("hold")
    thread.join()
    assert caught[0].code == "RSI-010"
    assert active_arm.state is Lifecycle.HOLD


@pytest.mark.hazard(32)
def test_a_motion_begun_while_a_hold_is_carried_out_is_refused(
    active_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = active_arm.read_state().commanded_rad
    wait = MotionFollower.wait

    def move_once_the_stop_is_seen(*condition: Any) -> Any:
        state = wait(*condition)
        monkeypatch.setattr(MotionFollower, "wait", wait)
        with pytest.raises(WrongState):
            active_arm.move(JointMove(FAR))
        return state

    monkeypatch.setattr(MotionFollower, "wait", move_once_the_stop_is_seen)
    active_arm.stop(StopKind.HOLD)
    assert active_arm.state is Lifecycle.HOLD
    assert active_arm.read_state().commanded_rad == held


@pytest.mark.hazard(32)
def test_a_hold_right_after_the_state_was_checked_refuses_the_motion(
    active_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = active_arm.read_state().commanded_rad
    require = LifecycleGuard.require

    def check_and_be_stopped(guard: LifecycleGuard, call: str, allowed: Any) -> None:
        require(guard, call, allowed)
        monkeypatch.setattr(LifecycleGuard, "require", require)
        active_arm.stop(StopKind.HOLD)

    monkeypatch.setattr(LifecycleGuard, "require", check_and_be_stopped)
    with raises(STREAM_ERRORS.stopped, match="stopped before it began"):
        active_arm.move(JointMove(FAR))
    assert active_arm.read_state().commanded_rad == held


@pytest.mark.parametrize("state", [Lifecycle.ACTIVE, Lifecycle.HOLD])
def test_a_stop_that_fails_leaves_the_state_as_it_was(
    active_arm: Any, monkeypatch: pytest.MonkeyPatch, state: Lifecycle
) -> None:
    if state is Lifecycle.HOLD:
        active_arm.stop(StopKind.HOLD)
    with monkeypatch.context() as patched:
        patched.setattr(MotionFollower, "wait", lambda *_condition: None)
        with raises(STREAM_ERRORS.not_finished, match="does not come to rest"):
            active_arm.stop(StopKind.HOLD)
    assert active_arm.state is state


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        (StopKind.PROTECTIVE, STREAM_ERRORS.protective_stop),
        (StopKind.DRIVES_OFF, STREAM_ERRORS.drives_off),
        pytest.param(StopKind.LINK, STREAM_ERRORS.link_stopped, marks=pytest.mark.slow),
    ],
)
@pytest.mark.hazard(32)
def test_every_stop_except_hold_is_latched_until_recovered(
    controller: Any, active_arm: Any, kind: StopKind, error: ErrorCode[RonnaError]
) -> None:
    thread, caught = moving(active_arm, controller)
    active_arm.stop(kind)
    thread.join()
    assert caught[0].code == error.code
    assert active_arm.state is Lifecycle.FAULT
    assert active_arm.fault.code == error.code
    assert largest_step(controller.replies) < 1 / 8
    with pytest.raises(WrongState, match=error.code):  # later calls are refused and name it
        active_arm.read_state()
    if kind is StopKind.DRIVES_OFF:
        assert controller.facts["Drives"] == "0"
    active_arm.recover("operator")
    assert active_arm.state is Lifecycle.CONFIGURED
    assert "ACK_ERRORS" in controller.commands
    active_arm.activate()
    active_arm.move(JointMove(THERE))


@pytest.mark.hazard(32)
def test_of_two_stops_within_one_cycle_the_stronger_one_counts(active_arm: Any) -> None:
    link = active_arm.connections.link
    os.kill(link.process.pid, signal.SIGSTOP)
    os.waitid(os.P_PID, link.process.pid, os.WSTOPPED)
    link.stop(StopOrder.PROTECTIVE)
    link.stop(StopOrder.HOLD)
    os.kill(link.process.pid, signal.SIGCONT)
    eventually(lambda: link.state.stop_number == 2)
    eventually(lambda: link.state.fault)
    assert link.state.fault is LinkFault.PROTECTIVE
    assert active_arm.state is Lifecycle.FAULT


def test_a_protective_stop_before_a_session_does_not_make_one_of_its_holds(make_arm: Any) -> None:
    arm = configured(make_arm())
    arm.stop(StopKind.PROTECTIVE)
    arm.activate()
    arm.stop(StopKind.HOLD)
    assert arm.state is Lifecycle.HOLD


def test_a_motion_that_does_not_settle_is_reported_after_its_time_limit(
    make_arm: Any, controller: Any
) -> None:
    arm = activated(make_arm())
    controller.frozen = True
    with raises(STREAM_ERRORS.not_finished) as caught:
        arm.move(JointMove(radians6(0, -90, 90, 0, 60, 0.05)), timeout_s=0.5)
    assert caught.value.code == "RSI-011"


def test_an_arm_at_rest_off_its_goal_is_reported_after_the_settle_limit_not_the_motion_timeout(
    active_arm: Any, controller: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronna_hw.arm_stream.motion.SETTLE_LIMIT_S", 0.5)
    controller.frozen = True
    with raises(
        STREAM_ERRORS.not_finished,
        match=r"did not settle at the end of its path; limit 0\.5 s, got A6 -0\.0500 deg off",
    ):
        active_arm.move(JointMove(radians6(0, -90, 90, 0, 60, 0.05)), timeout_s=HANG_LIMIT_S)


@pytest.mark.hazard(38)
def test_a_pushed_arm_is_in_fault_although_it_is_deactivated(active_arm: Any, controller: Any) -> None:
    controller.frozen = True
    controller.axes_deg = (controller.axes_deg[0] + 1.0, *controller.axes_deg[1:])
    eventually(lambda: active_arm.connections.link.state.fault)
    with pytest.raises(RonnaError, match="RSI-005"):
        active_arm.deactivate()
    assert active_arm.state is Lifecycle.FAULT
