"""The controller driven by ur-rtde, a third-party client, in a process of its own.

A wrong answer can block that client for minutes, so it has a time limit.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from importlib.util import find_spec
from math import dist, hypot
from pathlib import Path
from typing import Any

import pytest
from ur_clients import UrCell

MISSING = (
    "left out: ur-rtde 1.6.5 as a client of the simulator; it has wheels for Linux on x86-64, Python < 3.13"
)
pytestmark = pytest.mark.skipif(find_spec("rtde_control") is None, reason=MISSING)

LIMIT_S = 60.0
ROUNDING = 1e-6
CLIENT = """
import json, math, sys, time
from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface
from script_client import ScriptClient

address = sys.argv[1]
found = {}
dashboard = DashboardClient(address)
dashboard.connect()
receive = RTDEReceiveInterface(address)
control = RTDEControlInterface(address)
io = RTDEIOInterface(address)
script = ScriptClient(address, 5, 11)
script.connect()

def eventually(holds):
    until = time.monotonic() + 5.0
    while time.monotonic() < until:
        if holds():
            return True
        time.sleep(0.002)
    return False

def near(values, wanted):
    return max(abs(a - b) for a, b in zip(values, wanted)) < 1e-6

found["robotmode"], found["remote"] = dashboard.robotmode(), dashboard.isInRemoteControl()
start = receive.getActualQ()
goal = [start[0] + 0.1, *start[1:]]
found["moveJ"] = control.moveJ(goal, 2.0, 20.0)
found["joints"] = eventually(lambda: near(receive.getActualQ(), goal))
found["zero_offset"] = control.getForwardKinematics(goal, [0.0] * 6)
found["full_turn"] = control.getForwardKinematics(goal, [0.0] * 5 + [2.0 * math.pi])
found["flange"] = control.getForwardKinematics()
line = receive.getActualTCPPose()
line[2] += 0.02
found["moveL"] = control.moveL(line, 1.0, 10.0)
found["line"] = eventually(lambda: near(receive.getActualTCPPose()[:3], line[:3]))
found["pose"] = receive.getActualTCPPose()
found["inverse"], found["at"] = control.getInverseKinematics(line), receive.getActualQ()
found["forward"] = control.getForwardKinematics()
for number in range(40):
    began = control.initPeriod()
    found["servo"] = [goal[0] - 0.001 * number, *goal[1:]]
    control.servoJ(found["servo"], 0, 0, 0.002, 0.03, 500)
    control.waitPeriod(began)
found["served"] = eventually(lambda: abs(receive.getActualQ()[0] - found["servo"][0]) < 1e-6)
control.servoStop()
for _ in range(40):
    began = control.initPeriod()
    control.speedJ([0.1, 0, 0, 0, 0, 0], 5.0, 0.002)
    control.waitPeriod(began)
found["speedJ"] = eventually(lambda: near(receive.getTargetQd()[:1], [0.1]))
control.speedStop()
control.moveJ(start, 1.0, 1.0, True)
found["moves"] = eventually(lambda: receive.getActualQd()[0] < -0.01)
control.stopJ(10.0)
found["stopped"] = eventually(lambda: near(receive.getTargetQd(), [0.0] * 6))
control.setTcp([0, 0, 0.1, 0, 0, 0])
found["tcp"] = control.getTCPOffset()
io.setStandardDigitalOut(1, True)
io.setSpeedSlider(0.5)
found["slowed"] = eventually(lambda: receive.getTargetSpeedFraction() == 0.5)
found["outputs"] = eventually(lambda: receive.getDigitalOutState(1))
script.sendScriptCommand("sec outputs():\\nset_digital_out(0, True)\\nend\\n")
found["script"] = eventually(lambda: receive.getDigitalOutState(0))
control.triggerProtectiveStop()
found["protective"] = eventually(receive.isProtectiveStopped)
found["running"] = control.isProgramRunning()
def unlock():
    try:
        dashboard.unlockProtectiveStop()
    except RuntimeError:
        return False
    return True
found["too_early"] = not unlock()
found["unlocked"] = eventually(lambda: unlock() and not receive.isProtectiveStopped())
dashboard.stop()
control.reuploadScript()
found["again"] = eventually(control.isProgramRunning) and control.moveJ(start, 3.0, 20.0)
print(json.dumps(found), flush=True)
import os
os._exit(0)  # each of its connections takes half a second to close
"""


@pytest.fixture(scope="module")
def found() -> Iterator[dict[str, Any]]:
    with ExitStack() as stack:
        cell = UrCell(stack, "--set", "protective_stop_lock_s=1", number=2)
        client = subprocess.run(
            (sys.executable, "-c", CLIENT, cell.address),
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            cwd=Path.home(),
        )
        assert client.returncode == 0, client.stderr
        yield json.loads(client.stdout.splitlines()[-1])


def test_its_dashboard_client_reads_mode_and_remote_control(found: dict[str, Any]) -> None:
    assert found["robotmode"] == "Robotmode: RUNNING"
    assert found["remote"] is True


def test_it_moves_to_joints_and_along_a_line(found: dict[str, Any]) -> None:
    assert found["moveJ"]
    assert found["moveL"]
    assert found["joints"]
    assert found["line"]


def test_it_computes_the_kinematics_as_the_arm_moves(found: dict[str, Any]) -> None:
    assert found["inverse"] == pytest.approx(found["at"], abs=ROUNDING)
    assert found["forward"][:3] == pytest.approx(found["pose"][:3], abs=ROUNDING)
    assert found["tcp"] == pytest.approx([0, 0, 0.1, 0, 0, 0])


def test_its_zero_offset_is_what_the_last_motion_left_in_the_registers(found: dict[str, Any]) -> None:
    # It sends a zero offset as none, with the recipe of the joints alone; its script reads registers 6 to 11
    # all the same, where moveJ has put its speed and acceleration. A full turn is sent, and no offset either.
    assert found["full_turn"][:3] == pytest.approx(found["flange"][:3], abs=ROUNDING)
    assert dist(found["zero_offset"][:3], found["flange"][:3]) == pytest.approx(
        hypot(2.0, 20.0), abs=ROUNDING
    )


def test_it_streams_joints_and_speeds_and_stops(found: dict[str, Any]) -> None:
    assert found["served"]
    assert found["speedJ"]
    assert found["moves"]
    assert found["stopped"]


def test_it_switches_outputs_by_rtde_and_by_script(found: dict[str, Any]) -> None:
    assert found["slowed"]
    assert found["outputs"]
    assert found["script"]


def test_it_comes_back_from_a_protective_stop_after_its_time(found: dict[str, Any]) -> None:
    assert found["protective"]
    assert not found["running"]
    assert found["too_early"]
    assert found["unlocked"]
    assert found["again"]
