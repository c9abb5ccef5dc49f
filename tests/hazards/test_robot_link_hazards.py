"""Hazards 4, 18, 20, 30: the robot link over the wire, judged by the arm's true position."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from rsi_tap import RsiTap
from user_commands import Commands
from waiting import eventually

from drivers.kuka_rsi.errors import CONTROLLER_STOPPED, WRONG_CONTROLLER
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.motion.limits import WORKING_SPEED_FRACTION
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import RonnaError

CYCLE_S = 0.004
FULL_STEP_RAD = np.array(kr6_r900(SIXX).full_speed_rad_s) * CYCLE_S
WORKING_STEP_SHARE = WORKING_SPEED_FRACTION + 1e-3  # of a full-speed step: one prepared step and rounding
LATE_STEP_SHARE = 2 * WORKING_SPEED_FRACTION + 1e-3  # two at once, below the quarter that a controller takes
TAKEN_STEP_SHARE = 0.25  # what a controller takes in one cycle
TWO_UNTOLD_SPEED_FRACTION = 0.08  # at which three steps at once are below that
AWAY_RAD = 0.5
LARGEST_ERROR_MM = 1.5  # at the target, as without any loss
# A killed program is that of tests/system/robot/test_kuka_driver.py.
HALTS = [signal.SIGSTOP, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)]
GENEROUS_S = 5.0  # for limits that are not the subject of a test: these machines stall

MOVER = """
import sys
from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.robot import JointMove

rsi, eki, clock, heartbeat_limit_s = sys.argv[1:]
options = {"heartbeat_limit_s": float(heartbeat_limit_s), "silence_limit_s": 5.0}
config = DeviceConfig(driver="kuka_rsi", endpoints={"rsi": rsi, "eki_project": eki}, options=options)
arm = KukaRsiArm("robot.master", config, open_clock(clock))
arm.connect(); arm.configure(); arm.activate()
start = arm.read_state().joints_rad
print("moving", flush=True)
arm.move(JointMove((start[0] + 2.5, *start[1:]), speed_fraction=0.5))
print("arrived", flush=True)
"""


def _away(joints_rad: Any, angle_rad: float = AWAY_RAD) -> Any:
    return tuple(angle + angle_rad for angle in joints_rad)


def _largest_steps(tap: RsiTap) -> tuple[float, float]:
    """Largest step that was commanded, and of the arm itself, over the full-speed step of its axis."""
    commanded = np.radians(np.diff(np.array(tap.acting_deg), axis=0))
    truly = np.diff(np.array(tap.seen), axis=0)
    return float((np.abs(commanded) / FULL_STEP_RAD).max()), float((np.abs(truly) / FULL_STEP_RAD).max())


@pytest.mark.hazard(18)
@pytest.mark.parametrize(
    "late",
    [
        pytest.param(False, id="told at once", marks=pytest.mark.slow),
        pytest.param(True, id="told a telegram late"),
    ],
)
@pytest.mark.parametrize(
    "lost_percent", [*(pytest.param(share, marks=pytest.mark.slow) for share in (1, 5, 10)), 20]
)
def test_the_arm_arrives_without_a_jump_while_replies_are_lost_at_full_working_speed(
    tapped_cell: Any, lost_percent: int, late: bool
) -> None:
    cell, tap = tapped_cell(late=late)
    arm = cell.active_arm(silence_limit_s=GENEROUS_S, heartbeat_limit_s=GENEROUS_S)
    start = arm.read_state().joints_rad
    cell.world.set_fault_script(f"at 0 s: robot drop {lost_percent} % for 1000 s")
    for target in (_away(start), start):
        arm.move(JointMove(target))
        assert cell.true_joints_rad() == pytest.approx(target, abs=1e-5)
    assert arm.state is Lifecycle.ACTIVE
    assert max(_largest_steps(tap)) < (LATE_STEP_SHARE if late else WORKING_STEP_SHARE)
    assert arm.connections.link.state.degraded or lost_percent == 1
    cell.world.set_fault_script("")
    eventually(lambda: arm.link_statistics().late_cycles == tap.lost)
    assert tap.lost > 0
    assert arm.link_statistics().lost_cycles == 0


def _lose_at_speed(cell: Any, tap: RsiTap, neighbours: int, speed_fraction: float) -> None:
    """Lose so many neighbouring replies as soon as an axis has reached its working speed."""

    def lose_when_fast() -> None:
        step = np.radians(np.subtract(tap.acting_deg[-1], tap.acting_deg[-2])) / FULL_STEP_RAD
        if np.abs(step).max() > 0.99 * speed_fraction:
            tap.on_cycle = None
            begin_s, length_s = cell.world.clock.now_s() - CYCLE_S / 4, (neighbours - 0.5) * CYCLE_S
            cell.world.set_fault_script(f"at {begin_s} s: robot drop 100 % for {length_s} s")

    tap.on_cycle = lose_when_fast


@pytest.mark.hazard(18)
@pytest.mark.parametrize(
    "late",
    [
        pytest.param(False, id="told at once"),
        pytest.param(True, id="told a telegram late", marks=pytest.mark.slow),
    ],
)
def test_the_arm_continues_without_a_jump_after_a_burst_of_lost_replies_at_full_working_speed(
    tapped_cell: Any, late: bool
) -> None:
    cell, tap = tapped_cell(late=late)
    arm = cell.active_arm(silence_limit_s=GENEROUS_S, heartbeat_limit_s=GENEROUS_S)
    start = arm.read_state().joints_rad
    for neighbours, target, late_cycles in ((2, _away(start), 2), (25, start, 27)):
        _lose_at_speed(cell, tap, neighbours, WORKING_SPEED_FRACTION)
        arm.move(JointMove(target))
        assert cell.true_joints_rad() == pytest.approx(target, abs=1e-5)
        assert arm.state is Lifecycle.ACTIVE
        assert arm.link_statistics().late_cycles == late_cycles
    assert max(_largest_steps(tap)) < (LATE_STEP_SHARE if late else WORKING_STEP_SHARE)


@pytest.mark.hazard(18)
@pytest.mark.parametrize(
    ("neighbours", "speed_fraction"),
    [pytest.param(1, WORKING_SPEED_FRACTION, marks=pytest.mark.slow), (2, TWO_UNTOLD_SPEED_FRACTION)],
)
def test_lost_replies_the_controller_never_reports_lead_to_one_longer_step_that_it_accepts(
    tapped_cell: Any, neighbours: int, speed_fraction: float
) -> None:
    cell, tap = tapped_cell(never=True)
    arm = cell.active_arm(
        silence_limit_s=GENEROUS_S, heartbeat_limit_s=GENEROUS_S, speed_fraction=speed_fraction
    )
    target = _away(arm.read_state().joints_rad)
    _lose_at_speed(cell, tap, neighbours, speed_fraction)
    arm.move(JointMove(target))
    assert cell.true_joints_rad() == pytest.approx(target, abs=1e-5)
    assert tap.lost == neighbours
    assert arm.link_statistics().late_cycles == 0
    # What came after the held values is the whole way in one step.
    longest, _ = _largest_steps(tap)
    assert longest == pytest.approx((neighbours + 1) * speed_fraction, rel=0.02)
    assert longest < TAKEN_STEP_SHARE


@pytest.mark.hazard(18)
def test_two_unreported_lost_replies_in_a_row_at_full_working_speed_make_the_controller_stop(
    tapped_cell: Any,
) -> None:
    cell, tap = tapped_cell(never=True)
    arm = cell.active_arm(silence_limit_s=GENEROUS_S, heartbeat_limit_s=GENEROUS_S)
    start = arm.read_state().joints_rad
    _lose_at_speed(cell, tap, 2, WORKING_SPEED_FRACTION)
    with raises(CONTROLLER_STOPPED, match="message"):
        arm.move(JointMove(_away(start)))
    assert arm.state is Lifecycle.FAULT
    eventually(lambda: cell.world.arm().at_rest)
    # The longer step was refused and not followed.
    _, truly = _largest_steps(tap)
    assert truly < LATE_STEP_SHARE
    assert cell.true_joints_rad()[0] < start[0] + AWAY_RAD - 0.01


@pytest.mark.hazard(18)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "suspends"),
    [
        ("when step == relocalization: robot drop 5 % for 3 s", False),
        (
            "at 0 s: robot drop 20 % for 10 s",
            True,
        ),  # the driver works through it, a case waits for a better link
    ],
)
def test_a_case_reaches_its_targets_while_replies_are_lost(
    tmp_path: Path, fault: str, suspends: bool
) -> None:
    script = tmp_path / "faults"
    script.write_text(fault + "\n")
    commands = Commands()
    case = ("run", "--sim", "--scene", "mini", "--seed", "7", "--json", "--faults", str(script))
    done = commands.run("ronna-procedure", *case, "--out", str(tmp_path / "runs"))
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    assert 0.0 < outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    assert commands.await_no_survivors() == []
    if suspends:
        journal = read_journal(tmp_path / "runs" / outcome["run"] / JOURNAL_FILE)
        rested = [line for line in journal if line["entry"] == Entry.RESTED]
        assert [str(line["reason"]).partition(":")[0] for line in rested] == ["robot link"]


@pytest.mark.hazard(20)
@pytest.mark.parametrize("option", [("--corrections", "relative"), ("--cycle-ms", "12")])
def test_a_controller_in_another_mode_or_cycle_is_refused_before_anything_moves(
    robot_cell: Any, option: tuple[str, str]
) -> None:
    cell = robot_cell(*option)
    before = cell.true_joints_rad()
    arm = cell.arm()
    with raises(WRONG_CONTROLLER):
        arm.connect()
    assert arm.state is Lifecycle.DISCONNECTED
    assert (cell.true_joints_rad() == before).all()


@pytest.mark.hazard(20)
def test_the_arm_also_arrives_with_a_cycle_of_twelve_milliseconds(robot_cell: Any) -> None:
    cell = robot_cell("--cycle-ms", "12")
    arm = cell.active_arm(cycle_ms=12, silence_limit_s=GENEROUS_S)
    target = _away(arm.read_state().joints_rad, 0.1)
    arm.move(JointMove(target))
    assert cell.true_joints_rad() == pytest.approx(target, abs=1e-5)
    assert arm.link_statistics().lost_cycles == 0


@pytest.mark.hazard(4)
def test_a_controller_that_dies_during_a_motion_latches_a_fault_and_no_more_poses_are_returned(
    robot_cell: Any,
) -> None:
    cell = robot_cell(paced=True)
    arm = cell.active_arm(silence_limit_s=0.2, heartbeat_limit_s=GENEROUS_S)
    os.kill(cell.controller.process.pid, signal.SIGKILL)
    cell.controller.process.wait()
    with pytest.raises(RonnaError):
        arm.move(JointMove(_away(arm.read_state().joints_rad)))
    assert arm.state is Lifecycle.FAULT
    with pytest.raises(RonnaError):
        arm.read_state()


@pytest.mark.hazard(30)
@pytest.mark.parametrize("halt", HALTS)
def test_the_arm_comes_to_rest_before_its_target_when_the_program_driving_it_halts(
    robot_cell: Any, halt: signal.Signals
) -> None:
    cell = robot_cell(paced=True)
    start = cell.true_joints_rad()
    arguments = [cell.endpoints["rsi"], cell.endpoints["eki_project"], cell.world.clock_endpoint, "0.2"]
    mover = subprocess.Popen(
        [sys.executable, "-P", "-c", MOVER, *arguments], stdout=subprocess.PIPE, text=True
    )
    try:
        assert mover.stdout is not None
        assert mover.stdout.readline() == "moving\n"
        eventually(lambda: cell.true_joints_rad()[0] > start[0] + 0.1)
        os.kill(mover.pid, halt)
        eventually(lambda: cell.world.arm().at_rest)
        assert cell.true_joints_rad()[0] < start[0] + 2.4  # on the way, not at the end of the motion
        rest = cell.world.arm()
        # The program on the controller ends as well: nobody is left to correct it.
        cell.world.clock.sleep(0.5)
        assert cell.world.arm().joints_rad == rest.joints_rad
    finally:
        mover.kill()
        mover.wait()
        assert mover.stdout is not None
        mover.stdout.close()
