"""A hundred kills and freezes of the program or of its real-time process, at random moments of a motion.

Times are the controller's, by its packages: a busy computer does not stretch them.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from ur_clients import OUTPUTS, State, UrCell
from waiting import eventually

from drivers.universal_robots.options import STOP_DECELERATION_RAD_S2
from ronna_hw.wire.universal_robots import ScriptState

pytestmark = [pytest.mark.soak, pytest.mark.timeout(3600), pytest.mark.hazard(30)]

KILLS = 25  # of each kind
LONGEST_LIFE_S = 1.0  # host time from the first motion on
STARVED_S = 0.024  # from the last set-point that the script used until it stops the arm by itself
CYCLE_S = 0.002
HEARTBEAT_S = 1.0  # of a frozen program
PATH_STOP_S = 1.0  # a stop on the path, and what this thread and the link may lag behind the controller
QUIET_S = 0.5  # after the stop, and after a frozen process has been thawed
GENEROUS_S = 60.0
STILL = (0.0,) * 6
MOVER = """
import sys
from drivers.universal_robots import UniversalRobotsArm
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.robot import JointMove

endpoints = dict(zip(("rtde", "dashboard", "primary"), sys.argv[1:]))
arm = UniversalRobotsArm("arm", DeviceConfig(driver="universal_robots", endpoints=endpoints), HostClock())
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


class Watcher:
    """Reads every package of the controller in a thread of its own."""

    def __init__(self, cell: UrCell) -> None:
        self.states: list[State] = []
        self._client = cell.rtde()
        self._client.ask("O", struct.pack(">d", 1.0 / CYCLE_S) + OUTPUTS.encode())
        self._client.ask("S")
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def now(self) -> State:
        return self.states[-1]

    def _read(self) -> None:
        with suppress(OSError, struct.error):
            while True:
                self.states.append(self._client.state())


@pytest.fixture(scope="module")
def cell() -> Iterator[UrCell]:
    with ExitStack() as stack:
        yield UrCell(stack, number=2)


@pytest.fixture(scope="module")
def watcher(cell: UrCell) -> Watcher:
    watching = Watcher(cell)
    eventually(lambda: bool(watching.states), GENEROUS_S)
    return watching


def is_moving(state: State) -> bool:
    return state.script == ScriptState.STREAMING and any(abs(speed) > 0.05 for speed in state.speed_rad_s)


def is_at_rest(state: State) -> bool:
    return state.script != ScriptState.STREAMING and tuple(state.speed_rad_s) == STILL


def is_still(state: State) -> bool:
    return tuple(state.speed_rad_s) == STILL


def await_cycles(watcher: Watcher, duration_s: float) -> None:
    end_s = watcher.now.timestamp_s + duration_s
    eventually(lambda: watcher.now.timestamp_s > end_s, GENEROUS_S)


def first(states: list[State], condition: Callable[[State], bool]) -> State:
    return next(state for state in states if condition(state))


def controller_time_s(cell: UrCell) -> float:
    """Return the time stamp of a package that was sent after this call."""
    client = cell.rtde()
    client.ask("O", struct.pack(">d", 1.0 / CYCLE_S) + OUTPUTS.encode())
    client.ask("S")
    with contextlib.closing(client.socket):
        return client.state().timestamp_s


@contextlib.contextmanager
def moving_program(cell: UrCell) -> Iterator[tuple[Any, int]]:
    """Yield a program that moves its arm, and the process number of its link."""
    addresses = [cell.endpoints[role] for role in ("rtde", "dashboard", "primary")]
    arguments = [sys.executable, "-P", "-c", MOVER, *addresses]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
        assert program.stdout is not None
        line = program.stdout.readline()
        try:
            yield program, int(line or 0)
        finally:
            for pid in filter(None, (program.pid, int(line or 0))):
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


def interrupt(
    cell: UrCell, watcher: Watcher, chance: random.Random, victim: str, number: signal.Signals
) -> tuple[float, float] | None:
    """Return what the stop took, and its ramp, in controller time; None if the arm was not moving then."""
    with moving_program(cell) as (program, link_pid):
        if not link_pid:
            return None
        with suppress(AssertionError):
            eventually(lambda: is_moving(watcher.now), GENEROUS_S)
        time.sleep(chance.random() * LONGEST_LIFE_S)
        pid = program.pid if victim == "program" else link_pid
        if not is_moving(watcher.now):
            return None
        del watcher.states[:-1]
        now_s = controller_time_s(cell)  # the watcher may be behind
        os.kill(pid, number)
        halted = is_at_rest if victim == "link" else is_still

        def has_halted(state: State) -> bool:
            return state.timestamp_s > now_s and halted(state)

        eventually(lambda: has_halted(watcher.now), GENEROUS_S)
        watched = list(watcher.states)
        rested = first(watched, has_halted)
        stopped = rested
        if victim == "link":
            stopped = first(watched, lambda state: state.script != ScriptState.STREAMING)
            assert stopped.script == ScriptState.STARVED
            now_s = first(watched, lambda state: state.used == stopped.used).timestamp_s
        await_cycles(watcher, HEARTBEAT_S + QUIET_S)  # a program thawed earlier may go on
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)
        await_cycles(watcher, QUIET_S)
        assert watcher.now.target_rad == rested.target_rad, "something followed"
    eventually(lambda: cell.dashboard("running") == "Program running: false", GENEROUS_S)
    fastest = max(map(abs, stopped.speed_rad_s))
    ramp_s = rested.timestamp_s - stopped.timestamp_s - fastest / STOP_DECELERATION_RAD_S2
    return stopped.timestamp_s - now_s, ramp_s


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
@pytest.mark.parametrize("victim", ["link", "program"])
def test_an_arm_whose_program_or_link_ends_or_freezes_at_any_moment_comes_to_rest_and_stays(
    cell: UrCell, watcher: Watcher, victim: str, number: signal.Signals
) -> None:
    chance = random.Random(f"{victim} {number}")
    limit_s = STARVED_S
    if victim == "program":
        limit_s = PATH_STOP_S + (HEARTBEAT_S if number == signal.SIGSTOP else 0.0)
    stops, ramps, tries = [], [], 0
    while len(stops) < KILLS:
        tries += 1
        assert tries < 4 * KILLS, "the arm is hardly ever moving"
        found = interrupt(cell, watcher, chance, victim, number)
        if found is None:
            continue
        stops.append(found[0])
        ramps.append(found[1])
        assert found[0] <= limit_s
        assert found[1] <= 4 * CYCLE_S, "longer than the script's own deceleration takes"
    print(f"{victim} {number.name}: {KILLS} of {tries} tries, stop begun within {max(stops) * 1e3:.0f} ms, "
          f"at rest {max(ramps) * 1e3:.1f} ms after its ramp at most")  # fmt: skip
