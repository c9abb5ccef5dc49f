"""The tracker simulator as a process: READY, hosts that connect and leave, and a timely end."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import termios
import time
from collections.abc import Callable, Iterator

import pytest
from parent_death import ends_with_its_parent
from user_commands import in_this_process
from waiting import HANG_LIMIT_S, STALL_OF_THE_COMPUTER_S

from ronna_hw.control_port import ask_control_port
from ronna_hw.host.child_process import STOP_TIMEOUT_S, ChildProcess, command
from sim.cli import app

ANSWER_LIMIT_S = 5.0
ENDPOINTS = ("serial-pty", pytest.param("tcp://127.0.0.1:0", marks=pytest.mark.slow))


class Host:
    """A host that knows nothing but bytes."""

    def __init__(self, endpoint: str) -> None:
        self._socket: socket.socket | None = None
        if endpoint.startswith("serial://"):
            self._file = os.open(endpoint.removeprefix("serial://"), os.O_RDWR | os.O_NOCTTY)
            termios.tcflush(self._file, termios.TCIFLUSH)
        else:
            port = int(endpoint.rsplit(":", 1)[1])
            self._socket = socket.create_connection(("127.0.0.1", port))
            self._file = self._socket.fileno()

    def ask(self, line: str) -> bytes:
        """The answer to one line."""
        self.write(line.encode() + b"\r")
        return self.read()

    def write(self, data: bytes) -> None:
        os.write(self._file, data)

    def read(self) -> bytes:
        """One ASCII answer, up to its CR."""
        answer = b""
        deadline = time.monotonic() + ANSWER_LIMIT_S
        while not answer.endswith(b"\r"):
            ready, _, _ = select.select([self._file], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, f"no answer, only {answer!r}"
            answer += os.read(self._file, 1)
        return answer

    def discard(self) -> None:
        """Throw away what waits, as every client does before it begins."""
        while select.select([self._file], [], [], 0.2)[0]:
            if not os.read(self._file, 65536):
                return

    def set_baud(self, baud: int) -> None:
        """Give the line another rate."""
        settings = termios.tcgetattr(self._file)
        settings[4] = settings[5] = getattr(termios, f"B{baud}")
        termios.tcsetattr(self._file, termios.TCSANOW, settings)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._file)


@pytest.fixture
def start() -> Iterator[Callable[..., ChildProcess]]:
    """Start simulators; they are ended after the test."""
    running: list[ChildProcess] = []

    def begin(*arguments: str) -> ChildProcess:
        running.append(ChildProcess("ronna-sim polaris", command("sim.cli", "polaris", *arguments)))
        return running[-1]

    yield begin
    for child in running:
        child.stop()


@pytest.mark.parametrize("endpoint", ENDPOINTS)
def test_the_next_host_finds_the_unit_as_the_previous_one_left_it(
    start: Callable[..., ChildProcess], endpoint: str
) -> None:
    ready = start("--endpoint", endpoint).ready
    assert ready["device"] == "polaris"
    first = Host(ready["endpoint"])
    assert first.ask("INIT ") == b"OKAYA896\r"
    assert first.ask("PHRQ *********1****").startswith(b"01")
    first.close()
    second = Host(ready["endpoint"])
    assert second.ask("PHSR 00").startswith(b"0101001")
    second.close()


@pytest.mark.parametrize("endpoint", ENDPOINTS)
def test_sigterm_ends_the_simulator_in_time_with_a_host_connected(
    start: Callable[..., ChildProcess], endpoint: str
) -> None:
    child = start("--endpoint", endpoint)
    host = Host(child.ready["endpoint"])
    host.ask("INIT ")
    child.process.terminate()
    assert child.process.wait(STOP_TIMEOUT_S + STALL_OF_THE_COMPUTER_S) == 0
    host.close()


def test_the_simulator_does_not_outlive_its_parent() -> None:
    assert ends_with_its_parent(command("sim.cli", "polaris"))


def test_profile_and_behaviour_options_change_what_the_unit_reports(
    start: Callable[..., ChildProcess],
) -> None:
    ready = start("--profile", "vicra", "--set", "freeze_tag_with_minor=false").ready
    assert set(ready) == {"device", "endpoint", "control"}
    host = Host(ready["endpoint"])
    host.ask("INIT ")
    assert b"Freeze Tag: Polaris Vicra Rev 007\n" in host.ask("VER 4")
    host.close()


def test_an_impatient_third_party_client_gets_through_with_a_serial_break(
    start: Callable[..., ChildProcess],
) -> None:
    ndicapy = pytest.importorskip("ndicapy")
    ready = start().ready
    # It gives INIT 0.2 s, then sends a break and waits for RESET.
    ask_control_port(ready["control"], "fault", line="now: tracker slow INIT 0.6 s for 0.3 s")
    path = ready["endpoint"].removeprefix("serial://")
    assert ndicapy.ndiProbe(path) == ndicapy.NDI_OKAY
    device = ndicapy.ndiOpen(path)
    assert ndicapy.ndiCommand(device, "INIT:") == "OKAY"
    assert ndicapy.ndiCommand(device, "COMM:50000") == "OKAY"
    assert ndicapy.ndiRESET(device) == "RESET"
    with pytest.raises(OSError, match="0x10"):  # at 9600 baud again, and not initialised
        ndicapy.ndiCommand(device, "PHSR:00")
    ndicapy.ndiClose(device)


def test_the_unconfirmed_behaviours_can_be_listed() -> None:
    done = in_this_process(app, "polaris", "--list-parameters")
    assert done.returncode == 0
    assert "watch_dog=stop  Effect of the watchdog" in done.stdout
    assert done.stderr == ""


def test_ready_is_one_line_of_json_on_standard_output(start: Callable[..., ChildProcess]) -> None:
    done = subprocess.Popen(command("sim.cli", "polaris"), stdout=subprocess.PIPE, text=True)
    assert done.stdout is not None
    line = done.stdout.readline()
    done.terminate()
    rest = done.stdout.read()
    done.wait(HANG_LIMIT_S)
    done.stdout.close()
    assert json.loads(line.removeprefix("READY "))["endpoint"].startswith("serial:///dev/")
    assert rest == ""
