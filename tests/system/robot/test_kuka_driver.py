"""The arm driver and the simulated robot controller, each in processes of their own, over UDP and TCP."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from math import radians
from pathlib import Path
from typing import Any

import pytest
from waiting import eventually

from drivers.kuka_rsi import KukaRsiArm
from drivers.kuka_rsi.errors import STREAM_ERRORS
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.robot import JointMove
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint
from ronna_hw.vectors import JointVector

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


def _moved(joints: JointVector, *offsets_deg: float) -> JointVector:
    A1, A2, A3, A4, A5, A6 = (a + radians(d) for a, d in zip(joints, offsets_deg, strict=True))
    return (A1, A2, A3, A4, A5, A6)


@pytest.fixture
def endpoints() -> Iterator[dict[str, str]]:
    rsi = own_udp_endpoint()
    free = "tcp://127.0.0.1:0"
    arguments = command("sim.cli", "kuka", "--rsi", rsi, "--eki", free, "--eki-project", free)
    with ChildProcess("ronna-sim kuka", arguments) as child:
        yield {"rsi": rsi, "eki_project": child.ready["endpoints"]["eki_project"]}
        assert child.alive


@pytest.fixture
def make_arm(endpoints: dict[str, str]) -> Iterator[Callable[[], KukaRsiArm]]:
    made: list[KukaRsiArm] = []

    def make(**options: Any) -> KukaRsiArm:
        # Generous limits: these machines stall for tens of milliseconds.
        options = {"silence_limit_s": 2.0, "heartbeat_limit_s": 5.0, **options}
        config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints, options=options)
        made.append(KukaRsiArm("robot.master", config, HostClock()))
        return made[-1]

    yield make
    for arm in made:
        arm.close()


def _activated(arm: KukaRsiArm) -> KukaRsiArm:
    arm.connect()
    arm.configure()
    arm.activate()
    return arm


def _state(arm: KukaRsiArm) -> Lifecycle:
    return arm.state


@pytest.mark.hazard(30)
@pytest.mark.parametrize(
    ("how", "kills"),
    [
        (signal.SIGKILL, 1),
        pytest.param(signal.SIGTERM, 1, marks=pytest.mark.slow),
        pytest.param(signal.SIGKILL, 100, marks=(pytest.mark.soak, pytest.mark.timeout(3600))),
    ],
)
def test_after_kills_at_random_moments_the_arm_rests_and_the_next_program_continues(
    endpoints: dict[str, str], how: signal.Signals, kills: int
) -> None:
    chance = random.Random(30)
    arguments = [sys.executable, "-P", "-c", MOVER, endpoints["rsi"], endpoints["eki_project"]]
    for _ in range(kills):
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            link_pid = int(program.stdout.readline())
            time.sleep(chance.random() * LONGEST_LIFE_S)
            program.send_signal(how)
            program.wait()
        eventually(lambda pid=link_pid: not Path(f"/proc/{pid}").exists())  # type: ignore[misc]
        _start_again(endpoints)


def _start_again(endpoints: dict[str, str]) -> None:
    """Look at what a person would look at before going on, and go on from there without a jump."""
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


@pytest.mark.hazard(4)
def test_a_killed_link_process_leaves_a_message_that_recover_acknowledges(
    make_arm: Callable[[], KukaRsiArm],
) -> None:
    arm = _activated(make_arm())
    start = arm.read_state().joints_rad
    assert arm.connections.open_link is not None
    os.kill(arm.connections.open_link.process.pid, signal.SIGKILL)
    eventually(lambda: _state(arm) is Lifecycle.FAULT)
    assert arm.fault.code == STREAM_ERRORS.died.code
    eventually(
        lambda: (
            arm.connections.open_control is not None
            and arm.connections.open_control.latest is not None
            and arm.connections.open_control.latest.error != 0
        )
    )
    arm.recover("operator")
    arm.activate()
    reading = arm.move(JointMove(_moved(start, 1, 0, 0, 0, 0, 0)))
    assert reading.joints_rad == pytest.approx(_moved(start, 1, 0, 0, 0, 0, 0), abs=radians(0.0002))
