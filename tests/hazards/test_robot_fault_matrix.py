"""Hazards 4, 18 and 38: every controller and wire fault while the arm moves, and how it is reported."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from waiting import eventually

from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import RonnaError

AWAY_RAD = 0.6
UNDER_WAY_RAD = 0.1
SOON_S = 0.2  # theatre time: a controller on a busy machine has read the script by then
LIMITS = {"silence_limit_s": 3.0, "heartbeat_limit_s": 5.0}  # these machines stall
HANG_S = 60.0


class Case(NamedTuple):
    """A fault line, the codes of the error that may end the motion (none: it arrives), and its words."""

    fault: str
    codes: tuple[str, ...] = ()
    words: str = ""
    counter: str = ""  # of the link's statistics that must have grown
    speed_fraction: float = 0.4


# Its Timeout ends the run: EKI tells the message, or the telegrams cease.
CONTROLLER_GAVE_UP = ("EKI-010", "RSI-003")
WORKED_THROUGH = (
    Case("robot drop 20 % for 4 s", counter="late_cycles"),
    Case("robot drop 100 % for 0.2 s", counter="late_cycles"),
    Case("robot delay 1 cycles for 0.2 s", counter="late_cycles"),
    Case("robot duplicate 100 % for 4 s"),
    Case("robot reorder 5 % for 4 s", counter="late_cycles"),
    Case("robot corrupt replies 5 % for 4 s", counter="late_cycles"),
    Case("robot wrong ipoc 5 % for 4 s", counter="late_cycles"),
    Case("robot future ipoc 5 % for 4 s", counter="late_cycles"),
    Case("robot missing ipoc 5 % for 4 s", counter="late_cycles"),
    Case("robot wrong type 5 % for 4 s", counter="late_cycles"),
    Case("robot bad number 5 % for 4 s", counter="late_cycles"),
    Case("robot eki garbage"),
    Case("robot eki padding"),
    Case("robot corrupt telegrams 5 % for 4 s"),
    Case("robot lose telegrams 5 % for 4 s", counter="lost_cycles"),
    Case("robot foreign sender for 4 s", counter="foreign_telegrams"),
)
STOPPED = (
    Case("robot drop 50 % for 60 s", ("RSI-019",), "too few replies were accepted"),
    Case("robot corrupt replies 100 % for 60 s", CONTROLLER_GAVE_UP, ""),
    Case("robot wrong ipoc 100 % for 60 s", CONTROLLER_GAVE_UP, ""),
    Case("robot delay 2 cycles for 60 s", CONTROLLER_GAVE_UP, ""),
    Case("robot network cut for 60 s", ("RSI-003", "EKI-010"), ""),
    Case("robot emergency stop for 1 s", ("EKI-010",), "emergency stop is active"),
    Case("robot guard open for 1 s", ("EKI-010",), "guard is open"),
    Case("robot mode T1 for 1 s", ("EKI-010",), "operating mode is T1"),
    Case("robot drives off", ("EKI-010",), "drives are off"),
    Case("robot collision", ("EKI-010",), "message"),
    Case("robot constant ipoc for 60 s", CONTROLLER_GAVE_UP, ""),
    Case("robot trip torque", CONTROLLER_GAVE_UP, ""),
    Case("robot trip end_switch", CONTROLLER_GAVE_UP, ""),
    Case("robot clamp 2 deg for 60 s", ("RSI-005",), "following error"),
    Case("robot overload", ("RSI-005",), "following error"),
    Case("robot program restart", ("RSI-008", "RSI-003", "EKI-010"), ""),
    Case("robot eki cut", ("EKI-002",), "closed the connection"),
    Case("robot eki half telegram", ("EKI-004",), "is truncated"),
    Case("robot eki silence for 60 s", ("EKI-003",), "is silent", speed_fraction=0.1),
)
QUICK = ("robot foreign sender for 4 s", "robot overload")  # others stop in test_robot_stop_times.py


def _parameters(cases: tuple[Case, ...]) -> list[Any]:
    return [
        pytest.param(case, id=case.fault, marks=() if case.fault in QUICK else pytest.mark.slow)
        for case in cases
    ]


def _moved_through(cell: Any, arm: Any, happen: Callable[[], None], speed: float = 0.4) -> RonnaError | None:
    """The error of a long motion in which something happens on the way; None when it arrives."""
    start = arm.read_state().joints_rad
    caught: list[RonnaError] = []

    def move() -> None:
        try:
            arm.move(JointMove((start[0] + AWAY_RAD, *start[1:]), speed_fraction=speed))
        except RonnaError as error:
            caught.append(error)

    mover = threading.Thread(target=move)
    mover.start()
    eventually(lambda: abs(cell.true_joints_rad()[0] - start[0]) > UNDER_WAY_RAD)
    happen()
    mover.join(HANG_S)
    assert not mover.is_alive()
    return caught[0] if caught else None


def _begin(cell: Any, fault: str) -> Callable[[], None]:
    return lambda: cell.world.set_fault_script(f"at {cell.world.clock.now_s() + SOON_S} s: {fault}")


def _acted(cell: Any, fault: str) -> bool:
    """Whether the controller says that the fault was there: a busy machine may miss a short one."""
    phrase, _, _ = fault.partition(" for ")
    return any(phrase in message for message in cell.controller.messages)


@pytest.mark.hazard(18)
@pytest.mark.parametrize("case", _parameters(WORKED_THROUGH))
def test_a_motion_completes_despite_losses_that_the_link_tolerates(robot_cell: Any, case: Case) -> None:
    cell = robot_cell(paced=True)
    arm = cell.active_arm(**LIMITS)
    start = cell.true_joints_rad()
    error = _moved_through(cell, arm, _begin(cell, case.fault), case.speed_fraction)
    eventually(lambda: _acted(cell, case.fault))
    assert error is None, error
    assert arm.state is Lifecycle.ACTIVE
    assert cell.true_joints_rad()[0] == pytest.approx(start[0] + AWAY_RAD, abs=1e-3)
    if case.counter:
        assert getattr(arm.link_statistics(), case.counter) > 0


@pytest.mark.hazard(4)
@pytest.mark.hazard(38)
@pytest.mark.parametrize("case", _parameters(STOPPED))
def test_controller_and_wire_faults_stop_the_arm_and_are_named(robot_cell: Any, case: Case) -> None:
    cell = robot_cell(paced=True)
    arm = cell.active_arm(**LIMITS)
    start = cell.true_joints_rad()
    error = _moved_through(cell, arm, _begin(cell, case.fault), case.speed_fraction)
    assert error is not None
    assert error.code in case.codes, error
    assert case.words in str(error)
    assert "flight-record-robot.master.txt" in error.attachments
    assert arm.state is Lifecycle.FAULT
    eventually(lambda: cell.world.arm().at_rest)
    rest = cell.true_joints_rad()
    assert abs(rest[0] - start[0]) < AWAY_RAD - 0.01
    # The cause goes away; recovery acknowledges and reads anew, and moves nothing.
    cell.world.set_fault_script("")

    def recovered() -> bool:
        with contextlib.suppress(RonnaError):
            arm.recover("Ana")
        return bool(arm.state is Lifecycle.CONFIGURED)

    eventually(recovered)
    arm.activate()
    assert np.abs(cell.true_joints_rad() - rest).max() < 1e-3
    arm.move(JointMove(arm.read_state().commanded_rad))


@pytest.mark.hazard(4)
def test_a_halted_real_time_process_is_reported_and_replaced(robot_cell: Any) -> None:
    cell = robot_cell(paced=True)
    arm = cell.active_arm(silence_limit_s=0.25, heartbeat_limit_s=1.0)
    process = arm.connections.link.process
    start = cell.true_joints_rad()
    error = _moved_through(cell, arm, lambda: os.kill(process.pid, signal.SIGSTOP))
    assert error is not None
    # Whoever is first: the controller that gets no replies, or the driver that sees its process stand.
    assert error.code in ("RSI-020", "EKI-010"), error
    assert arm.state is Lifecycle.FAULT
    eventually(lambda: cell.world.arm().at_rest)
    assert abs(cell.true_joints_rad()[0] - start[0]) < AWAY_RAD - 0.01
    arm.recover("Ana")
    assert process.poll() is not None
    arm.activate()


@pytest.mark.slow  # a busy machine adds stalls of its own
@pytest.mark.hazard(18)
@pytest.mark.parametrize("stall_ms", [5, 50, 500])
def test_a_host_stall_is_tolerated_or_reported(robot_cell: Any, stall_ms: int) -> None:
    cell = robot_cell(paced=True)
    arm = cell.active_arm(**LIMITS)
    process = arm.connections.link.process
    start = cell.true_joints_rad()

    def stall() -> None:
        os.kill(process.pid, signal.SIGSTOP)
        begun_s = cell.world.clock.now_s()
        eventually(lambda: cell.world.clock.now_s() - begun_s >= stall_ms / 1000.0)
        os.kill(process.pid, signal.SIGCONT)

    error = _moved_through(cell, arm, stall)
    eventually(lambda: cell.world.arm().at_rest)
    if error is None:
        assert arm.state is Lifecycle.ACTIVE
        assert cell.true_joints_rad()[0] == pytest.approx(start[0] + AWAY_RAD, abs=1e-3)
        return
    # The controller's Timeout is 0.4 s, and such a machine adds stalls of its own.
    assert stall_ms >= 50, error
    assert error.code in CONTROLLER_GAVE_UP
    assert arm.state is Lifecycle.FAULT
    assert "flight-record-robot.master.txt" in error.attachments
    assert abs(cell.true_joints_rad()[0] - start[0]) < AWAY_RAD - 0.01
