"""A Universal Robots controller under storms of faults and connections: it can always be brought back."""

from __future__ import annotations

import contextlib
import random
import struct
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from ur_clients import OUTPUTS, RtdeClient, UrCell, script

from ronna_hw.control_port import ask_control_port
from ronna_hw.wire.universal_robots import RobotMode, RuntimeState, SafetyMode, ScriptState
from sim.world.faults.universal_robots import UR_FAULTS

pytestmark = pytest.mark.soak

ROUNDS = 60
RIDE_CYCLES = 250
LARGEST_STEP_RAD = 3.5 * 0.002  # at full speed, in a cycle, and a little
WORDS = {"INT": ("1", "3", "50"), "NUMBER": ("5", "30", "100"), "SIGNED": ("-20", "5", "30")}
CONNECTIONS = 1000
READY_CYCLES = 150  # after which the orders are repeated


@pytest.fixture
def cell() -> Iterator[UrCell]:
    with ExitStack() as stack:
        fast = (
            "power_on_s=0.05",
            "brake_release_s=0.05",
            "protective_stop_lock_s=0.05",
            "restart_safety_s=0.05",
        )
        options = [word for one in fast for word in ("--set", one)]
        yield UrCell(stack, *options, number=2)


def storm(generator: random.Random) -> list[str]:
    """Up to four faults at once."""
    lines = []
    for kind in generator.sample(UR_FAULTS, generator.randint(1, 4)):
        words = [generator.choice(WORDS.get(word, (word,))) for word in kind.phrase.split()]
        lasting = "" if kind.momentary else f" for {generator.uniform(0.02, 0.3):.3f} s"
        lines.append(f"now: ur {' '.join(words)}{lasting}")
    return lines


def bring_back(cell: UrCell) -> RtdeClient:
    """Return a client that streams at rest, whatever state the controller was in."""
    while True:
        with contextlib.suppress(OSError, AssertionError):
            for line in ("stop", "restart safety", "unlock protective stop", "power on", "brake release"):
                cell.dashboard(line)
            client = cell.rtde()
            client.set_up()
            for _ in range(READY_CYCLES):
                state = client.state()
                ready = (state.robot_mode, state.safety_mode) == (RobotMode.RUNNING, SafetyMode.NORMAL)
                if ready and state.runtime == RuntimeState.STOPPED:
                    client.put(0, 0, 1, state.target_rad)
                    with cell.connect("primary") as primary:
                        primary.sendall(script().encode())
                        while state.script != ScriptState.WAITING:
                            state = client.state()
                    return client


def ride(client: RtdeClient) -> None:
    """Stream a slow move; the arm never jumps between two packages."""
    before = client.state()
    start = before.target_rad
    for number in range(1, RIDE_CYCLES):
        client.put(number, 0, 1, [start[0] + 0.0002 * number, *start[1:]])
        state = client.state()
        cycles = round((state.timestamp_s - before.timestamp_s) / 0.002)
        largest = max(abs(b - a) for a, b in zip(before.target_rad, state.target_rad, strict=True))
        assert largest <= max(1, cycles) * LARGEST_STEP_RAD
        before = state


@pytest.mark.timeout(1200)
def test_the_controller_recovers_after_every_storm(cell: UrCell) -> None:
    generator = random.Random(7)
    control = cell.child.ready["control"]
    for _ in range(ROUNDS):
        ask_control_port(control, "clear_faults")
        client = bring_back(cell)
        for line in storm(generator):
            ask_control_port(control, "fault", line=line)
        with contextlib.suppress(OSError, struct.error):
            ride(client)
        client.socket.close()
    assert cell.child.alive


@pytest.mark.timeout(600)
@pytest.mark.parametrize("port", ["rtde", "dashboard", "primary", "realtime"])
def test_a_thousand_connections_and_one_that_never_reads_leave_others_served(cell: UrCell, port: str) -> None:
    with ExitStack() as stack:
        for _ in range(CONNECTIONS):
            stack.enter_context(contextlib.closing(cell.connect(port)))
        slow = RtdeClient(cell.endpoints["rtde"], receive_bytes=2048)
        stack.callback(slow.socket.close)
        slow.set_up()
        assert cell.dashboard("robotmode") == "Robotmode: RUNNING"
        client = cell.rtde()
        assert client.ask("O", struct.pack(">d", 500.0) + OUTPUTS.encode())[0]
        assert client.ask("S") == b"\1"
        first = client.state().timestamp_s
        while client.state().timestamp_s < first + 2.0:
            pass
    assert cell.dashboard("running") == "Program running: false"
