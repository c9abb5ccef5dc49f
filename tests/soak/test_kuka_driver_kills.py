"""A hundred kills of the program driving the arm, at random moments: the arm rests, the controller
is left clean, and the next program goes on from there without a jump.
"""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from math import radians
from pathlib import Path

import pytest
from waiting import eventually

from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600), pytest.mark.hazard(30)]

KILLS = 100
LONGEST_LIFE_S = 1.5  # of a program after its arm has begun to move
STILL_RAD = radians(0.002)
GENEROUS_S = 60.0  # host time: a soak runs beside other work

MOVER = """
import sys
from drivers.kuka_rsi import KukaRsiArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.robot import JointMove

endpoints = {"rsi": sys.argv[1], "eki_project": sys.argv[2]}
limits = {"silence_limit_s": 5.0, "heartbeat_limit_s": 5.0}  # what is not the subject here
config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints, options=limits)
arm = KukaRsiArm("robot.master", config, HostClock())
arm.connect(60.0)
arm.configure(60.0)
arm.activate(60.0)
print(arm.connections.link.process.pid, flush=True)
away = 0.5
while True:
    here = arm.read_state().commanded_rad
    arm.move(JointMove((away, *here[1:])))
    away = -away
"""


@pytest.fixture
def endpoints() -> Iterator[dict[str, str]]:
    rsi = own_udp_endpoint()
    free = "tcp://127.0.0.1:0"
    arguments = command("sim.cli", "kuka", "--rsi", rsi, "--eki", free, "--eki-project", free)
    with ChildProcess("ronna-sim kuka", arguments) as child:
        yield {"rsi": rsi, "eki_project": child.ready["endpoints"]["eki_project"]}
        assert child.alive


def test_after_kills_at_random_moments_the_arm_rests_and_the_next_program_continues(
    endpoints: dict[str, str],
) -> None:
    chance = random.Random(30)
    for _ in range(KILLS):
        arguments = [sys.executable, "-P", "-c", MOVER, endpoints["rsi"], endpoints["eki_project"]]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            link_pid = int(program.stdout.readline())
            time.sleep(chance.random() * LONGEST_LIFE_S)
            program.send_signal(signal.SIGKILL)
            program.wait()
        eventually(lambda pid=link_pid: not Path(f"/proc/{pid}").exists())  # type: ignore[misc]
        _look_after(endpoints)


def _look_after(endpoints: dict[str, str]) -> None:
    """What a person would look at before going on."""
    arm = KukaRsiArm("robot.master", DeviceConfig(driver="kuka_rsi", endpoints=endpoints), HostClock())
    try:
        arm.connect(GENEROUS_S)
        eventually(lambda: not arm.controller.state(GENEROUS_S).moving)
        rest = arm.read_state(GENEROUS_S).joints_rad
        assert arm.controller.state(GENEROUS_S).error == 0  # ended by its STOP object, not by the Timeout
        arm.configure(GENEROUS_S)
        arm.activate(GENEROUS_S)
        there = arm.read_state().joints_rad
        assert max(abs(a - b) for a, b in zip(rest, there, strict=True)) < STILL_RAD
        arm.deactivate(GENEROUS_S)
    finally:
        arm.close()
