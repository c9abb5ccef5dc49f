"""The serial line: line settings, breaks, power-up, throttling, and hosts that reconnect."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from coded_errors import raises

from sim.polaris.errors import LINE_UNAVAILABLE
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.line.pseudo_terminal import PseudoTerminal
from sim.polaris.line.server import EndSignal, Server
from sim.polaris.tracker_unit import SimulatedUnit, UnitMode
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

ANSWER_LIMIT_S = 30.0
QUIET_S = 0.1
OKAY, RESET = b"OKAYA896\r", b"RESETBE6F\r"
INPUT_SPEED, OUTPUT_SPEED, CONTROL_FLAGS = 4, 5, 2


class Host:
    """A host that can change every setting of its end."""

    def __init__(self, path: str) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY)

    def ask(self, line: str) -> bytes:
        termios.tcflush(self._file, termios.TCIFLUSH)  # as clients do before each command
        os.write(self._file, line.encode() + b"\r")
        return self.read()

    def write(self, data: bytes) -> None:
        os.write(self._file, data)

    def read(self) -> bytes:
        """Read up to a CR."""
        answer = b""
        while not answer.endswith(b"\r"):
            answer += self.read_some(1)
        return answer

    def read_some(self, size: int) -> bytes:
        assert select.select([self._file], [], [], ANSWER_LIMIT_S)[0], "no answer"
        return os.read(self._file, size)

    def hears_nothing(self, line: str) -> bool:
        os.write(self._file, line.encode() + b"\r")
        return not select.select([self._file], [], [], QUIET_S)[0]

    def set_line(self, baud: int = termios.B9600, flags: int = 0) -> None:
        settings = termios.tcgetattr(self._file)
        settings[INPUT_SPEED] = settings[OUTPUT_SPEED] = baud
        settings[CONTROL_FLAGS] |= flags
        termios.tcsetattr(self._file, termios.TCSANOW, settings)

    def send_break(self) -> None:
        termios.tcflush(self._file, termios.TCIOFLUSH)
        termios.tcsendbreak(self._file, 0)

    def flush_both(self) -> None:
        termios.tcflush(self._file, termios.TCIFLUSH)
        termios.tcflush(self._file, termios.TCOFLUSH)

    def flush_output(self) -> None:
        termios.tcflush(self._file, termios.TCOFLUSH)

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file = -1


class Line:
    """A unit on a serial line, in a thread of its own."""

    def __init__(self, *, throttle: bool = False, faults: str = "", **behaviour: Any) -> None:
        world = World.create(draw_scene("bench"), paced=True)
        world.set_fault_script(faults)
        self.interpreter = CommandInterpreter(SimulatedUnit(world, behaviour=UnitBehaviour(**behaviour)))
        self._end = EndSignal()
        self._terminal = PseudoTerminal(self.interpreter, throttle=throttle)
        server = Server(self.interpreter, self._end)
        self._thread = threading.Thread(target=server.serve_channel, args=(self._terminal,))
        self._thread.start()
        self._hosts = contextlib.ExitStack()

    def host(self) -> Host:
        host = Host(self._terminal.endpoint.removeprefix("serial://"))
        self._hosts.callback(host.close)
        return host

    def close(self) -> None:
        self._hosts.close()
        self._end.give()
        self._thread.join()
        self._terminal.close()


@pytest.fixture
def make_line() -> Iterator[Callable[..., Line]]:
    lines: list[Line] = []

    def make(**options: Any) -> Line:
        lines.append(Line(**options))
        return lines[-1]

    yield make
    for line in lines:
        line.close()


def test_power_up_sends_reset_at_9600_baud(make_line: Callable[..., Line]) -> None:
    host = make_line().host()
    assert host.read() == RESET
    assert host.ask("PHSR 00").startswith(b"ERROR10")
    assert host.ask("INIT:E3A5") == OKAY


def test_a_unit_that_was_already_on_sends_no_reset(make_line: Callable[..., Line]) -> None:
    host = make_line(power_up_reset=False).host()
    host.write(b"INIT:E3A5\r")
    assert host.read() == OKAY


@pytest.mark.parametrize(
    ("code", "baud"), [("5", termios.B115200), ("A", termios.B230400), ("6", termios.B921600)]
)
def test_comm_is_answered_at_the_old_rate_before_the_line_switches(
    make_line: Callable[..., Line], code: str, baud: int
) -> None:
    host = make_line().host()
    assert host.ask("INIT ") == OKAY
    assert host.ask(f"COMM {code}0000") == OKAY
    assert host.hears_nothing("ECHO x")
    host.set_line(baud)
    assert host.ask("ECHO x").startswith(b"x")
    assert host.ask("COMM 00000") == OKAY
    assert host.hears_nothing("ECHO x")
    host.set_line(termios.B9600)
    assert host.ask("ECHO x").startswith(b"x")


def test_a_command_at_a_wrong_rate_is_dropped(make_line: Callable[..., Line]) -> None:
    host = make_line().host()
    host.ask("INIT ")
    host.set_line(termios.B38400)
    assert host.hears_nothing("TSTART ")
    host.set_line(termios.B9600)
    assert host.ask("TX 0001").startswith(b"ERROR0C")


def test_a_wrong_rate_can_return_garbage(make_line: Callable[..., Line]) -> None:
    host = make_line(wrong_line="garbage").host()
    host.ask("INIT ")
    host.set_line(termios.B38400)
    host.write(b"ECHO x\r")
    assert all(byte > 0x7F for byte in host.read_some(100))


def test_odd_parity_must_be_set_at_both_ends(make_line: Callable[..., Line]) -> None:
    host = make_line().host()
    host.ask("INIT ")
    assert host.ask("COMM 00100") == OKAY
    assert host.hears_nothing("ECHO x")
    host.set_line(flags=termios.PARODD)
    assert host.ask("ECHO x").startswith(b"x")


def test_a_unit_that_does_not_enforce_the_line_answers_at_any_rate(make_line: Callable[..., Line]) -> None:
    host = make_line(enforces_line=False).host()
    assert host.ask("COMM 50000") == OKAY
    assert host.ask("ECHO x").startswith(b"x")


def test_seven_data_bits_corrupt_bx_replies(make_line: Callable[..., Line]) -> None:
    host = make_line().host()
    for command in ("INIT ", "COMM 01000", "TSTART "):
        assert host.ask(command) == OKAY
    host.write(b"BX 0001\r")
    assert host.read_some(2) == b"\x44\x25"  # of C4 A5


@pytest.mark.parametrize(
    ("line_after_close", "wrong", "right"),
    [("default", termios.B115200, termios.B9600), ("kept", termios.B9600, termios.B115200)],
)
def test_after_a_close_the_line_falls_back_or_keeps_its_rate_as_configured(
    make_line: Callable[..., Line], line_after_close: str, wrong: int, right: int
) -> None:
    line = make_line(line_after_close=line_after_close)
    first = line.host()
    assert first.ask("INIT ") == OKAY
    assert first.ask("COMM 50000") == OKAY
    first.close()
    second = line.host()
    second.set_line(wrong)
    assert second.hears_nothing("ECHO x")
    second.set_line(right)
    assert second.ask("PHSR 00").startswith(b"00")  # nothing else was forgotten


def test_a_restarting_unit_ignores_commands_until_it_sends_reset(make_line: Callable[..., Line]) -> None:
    line = make_line(break_deaf_s=0.0, reset_s=1.0)
    host = line.host()
    host.ask("INIT ")
    host.send_break()
    deadline_s = time.monotonic() + ANSWER_LIMIT_S
    while line.interpreter.unit.mode is not UnitMode.NOT_INITIALISED and time.monotonic() < deadline_s:
        time.sleep(0.01)
    host.write(b"INIT \r")
    assert host.read() == RESET
    assert host.ask("PHSR 00").startswith(b"ERROR10")


def test_a_break_interrupts_a_slow_command(make_line: Callable[..., Line]) -> None:
    line = make_line(break_deaf_s=0.0, faults="at 0 s: tracker slow INIT 0.5 s")
    host = line.host()
    host.ask("ECHO x")
    host.write(b"INIT \r")
    time.sleep(QUIET_S)  # as ndiProbe does
    host.send_break()
    assert host.read() == RESET
    assert host.ask("PHSR 00").startswith(b"ERROR10")


def test_a_flush_at_the_opening_of_a_line_is_not_taken_for_a_break(make_line: Callable[..., Line]) -> None:
    line = make_line()
    first = line.host()
    assert first.ask("INIT ") == OKAY
    first.close()
    second = line.host()
    second.send_break()
    assert second.ask("PHSR 00").startswith(b"00")
    second.flush_output()  # one direction alone is no break either
    assert second.ask("PHSR 00").startswith(b"00")


def test_flushing_both_directions_and_sending_on_is_not_a_break(make_line: Callable[..., Line]) -> None:
    host = make_line(break_deaf_s=0.0, break_silence_s=ANSWER_LIMIT_S).host()
    assert host.ask("INIT ") == OKAY
    for _ in range(20):
        host.flush_both()
        assert host.ask("PHSR 00").startswith(b"00")


def test_unavailable_pseudo_terminals_are_reported_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> tuple[int, int]:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "openpty", refuse)
    interpreter = CommandInterpreter(SimulatedUnit(World.create(draw_scene("bench"), paced=True)))
    with raises(LINE_UNAVAILABLE, match="No space left") as refused:
        PseudoTerminal(interpreter, throttle=False)
    assert refused.value.code == "PSU-003"


def test_throttling_counts_both_directions_and_every_bit(make_line: Callable[..., Line]) -> None:
    host = make_line(throttle=True).host()
    host.ask("INIT ")
    line = "ECHO " + "x" * 60

    def seconds() -> float:
        began_s = time.monotonic()
        assert len(host.ask(line)) == 65
        return time.monotonic() - began_s

    bytes_both_ways = len(line) + 1 + 65
    assert seconds() >= bytes_both_ways * 10 / 9600
    host.ask("COMM 30010")  # 38400 baud, two stop bits
    host.set_line(termios.B38400, termios.CSTOPB)
    assert seconds() >= bytes_both_ways * 11 / 38400
