"""The tracker's probe tells what is on its line, why nothing answers, and what to do about it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import socket
import subprocess
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest

from drivers.ndi_polaris import discovery, line_check
from drivers.ndi_polaris.line_check import (
    LineOpening,
    LineOutcome,
    LineState,
    check_line,
    line_diagnostic,
)
from drivers.ndi_polaris.probe import probe
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import ONLY, Search
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.host.port_users import PortUser
from ronna_hw.wire.polaris import crc16

ANSWER = b"G.001.005%04X\r" % crc16(b"G.001.005")
RATES = {termios.B9600: 9600, termios.B115200: 115200, termios.B230400: 230400}
Hears = Callable[[int, bytes], bytes]  # rate of the host, what it said -> what it hears


class OtherEnd:
    """Other end of a pseudo-terminal, which sees at which rate the host speaks."""

    def __init__(self, answer: Hears) -> None:
        self.answer = answer
        self.heard: list[tuple[int, bytes]] = []
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self.endpoint = parse_endpoint(f"serial://{self.path}")
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self) -> None:
        while True:
            try:
                said = os.read(self.master, 4096)
            except OSError:
                return
            if said == b"END":
                return
            rate = RATES.get(termios.tcgetattr(self.slave)[5], 0)
            self.heard.append((rate, said))
            os.write(self.master, self.answer(rate, said))

    def close(self) -> None:
        os.write(self.slave, b"END")
        self.thread.join(10.0)
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def other_end() -> Iterator[Callable[[Hears], OtherEnd]]:
    ends: list[OtherEnd] = []

    def make(answer: Hears) -> OtherEnd:
        ends.append(OtherEnd(answer))
        return ends[-1]

    yield make
    for end in ends:
        end.close()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "REPLY_LIMIT_S", 0.1)
    monkeypatch.setattr(line_check, "BAUDS", (9600, 115200, 230400))


def unit_at(baud: int, elsewhere: bytes = b"") -> Hears:
    return lambda rate, _said: ANSWER if rate == baud else elsewhere


@pytest.mark.parametrize(("elsewhere", "left_at"), [(b"", 9600), (b"", 115200), (b"\x80\xff\x00", 115200)])
def test_a_unit_is_found_at_the_rate_it_was_left_at(
    other_end: Callable[[Hears], OtherEnd], elsewhere: bytes, left_at: int
) -> None:
    state = check_line(other_end(unit_at(left_at, elsewhere)).endpoint)
    diagnostic = line_diagnostic(state)
    assert diagnostic.well
    assert diagnostic.seen == f"answered at {left_at}: G.001.005 (last bytes {ANSWER.hex(' ')})"
    assert ("An earlier program left it at this rate" in diagnostic.advice) is (left_at != 9600)
    assert [attempt.baud for attempt in state.attempts] == ([9600] if left_at == 9600 else [9600, 115200])
    assert state.last_bytes == ANSWER


GARBAGE, ECHO, SILENCE = LineOutcome.GARBAGE, LineOutcome.ECHO, LineOutcome.SILENCE


@pytest.mark.parametrize(
    ("hears", "outcomes", "seen", "advice"),
    [
        (
            lambda rate, _: b"\x80\xf8\x00\xe6" if rate == 9600 else b"",
            [GARBAGE, SILENCE, SILENCE],
            "garbage at 9600: bytes 80 f8 00 e6",
            "Probably another rate, or another device.* resets it to 9600 baud",
        ),
        (lambda _rate, _said: b"\r\nlogin: ", [GARBAGE] * 3, "garbage at", "'login:'"),
        (lambda _rate, said: said, [ECHO] * 3, "echoes our commands", "loop-back"),
        (lambda _rate, _said: b"", [SILENCE] * 3, "silent at 9600, 115200, 230400 baud", "powered"),
    ],
    ids=["garbage", "text", "loop-back", "silence"],
)
def test_a_line_without_a_unit_is_tried_at_every_rate_and_diagnosed(
    other_end: Callable[[Hears], OtherEnd], hears: Hears, outcomes: list[LineOutcome], seen: str, advice: str
) -> None:
    end = other_end(hears)
    state = check_line(end.endpoint)
    diagnostic = line_diagnostic(state)
    assert not diagnostic.well
    assert seen in diagnostic.seen
    assert re.search(advice, diagnostic.advice)
    assert [attempt.outcome for attempt in state.attempts] == outcomes
    assert {said for _, said in end.heard} == {b"APIREV:443E\r"}
    assert list(dict.fromkeys(rate for rate, _ in end.heard)) == [9600, 115200, 230400]


def test_a_garbled_first_reply_is_requested_again(other_end: Callable[[Hears], OtherEnd]) -> None:
    answers = iter([b"\xff\xfe", ANSWER])
    state = check_line(other_end(lambda _rate, _said: next(answers)).endpoint)
    assert state.answered_attempt is not None
    assert state.answered_attempt.baud == 9600


@pytest.fixture
def other_program(other_end: Callable[[Hears], OtherEnd]) -> Iterator[tuple[OtherEnd, int]]:
    """Return line and pid of a program that has the line open."""
    end = other_end(unit_at(9600))
    program = (
        f"import sys; port = open({end.path!r}, 'r+b', buffering=0); "
        "print('open', flush=True); sys.stdin.read()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "open\n"
    yield end, child.pid
    child.communicate("")


def test_another_program_is_named_and_its_line_is_left_alone(other_program: tuple[OtherEnd, int]) -> None:
    end, pid = other_program
    state = check_line(end.endpoint)
    diagnostic = line_diagnostic(state)
    assert not diagnostic.well
    assert diagnostic.seen.startswith("held by another program: ")
    assert f"(pid {pid})" in diagnostic.seen
    assert end.heard == []


@pytest.mark.hazard(34)
def test_a_network_line_that_another_program_uses_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_check, "find_tcp_clients", lambda *_: (PortUser(4711, "ronna-procedure"),))
    with socket.create_server(("127.0.0.1", 0)) as unit:
        diagnostic = line_diagnostic(check_line(Endpoint("tcp", "127.0.0.1", unit.getsockname()[1])))
        unit.setblocking(False)
        with pytest.raises(BlockingIOError):
            unit.accept()
    assert diagnostic.seen == "held by another program: ronna-procedure (pid 4711)"
    assert "leave it alone" in diagnostic.advice


def test_a_lock_with_an_invisible_holder_is_reported(
    other_end: Callable[[Hears], OtherEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = other_end(unit_at(9600))
    monkeypatch.setattr(line_check, "find_serial_port_users", lambda _path: ())
    locked = os.open(end.path, os.O_RDWR | os.O_NOCTTY)
    try:
        fcntl.flock(locked, fcntl.LOCK_EX)
        diagnostic = line_diagnostic(check_line(end.endpoint))
    finally:
        os.close(locked)
    assert "held by another program, not visible to this user" in diagnostic.seen
    assert f"sudo fuser -v {end.path}" in diagnostic.advice


def test_a_missing_permission_is_reported_and_nothing_is_sent(
    other_end: Callable[[Hears], OtherEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = other_end(unit_at(9600))
    monkeypatch.setattr(line_check.os, "access", lambda _path, _mode: False)
    state = check_line(end.endpoint)
    assert state.opening is LineOpening.FORBIDDEN
    diagnostic = line_diagnostic(state)
    assert diagnostic.seen == f"permission denied: {end.path}"
    assert end.heard == []


# --- TCP ---------------------------------------------------------------------------------------------------


@pytest.fixture
def listener() -> Iterator[Callable[[bytes | None], Endpoint]]:
    """Open a TCP port that answers everything with the same bytes, or hangs up when they are None."""
    servers: list[socket.socket] = []

    def make(answer: bytes | None) -> Endpoint:
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)

        def serve() -> None:
            try:
                peer, _ = server.accept()
            except OSError:
                return
            with peer, contextlib.suppress(ConnectionError):  # who asks may hang up at any moment
                while peer.recv(4096) and answer is not None:
                    peer.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        return Endpoint("tcp", host="127.0.0.1", port=server.getsockname()[1])

    yield make
    for server in servers:
        server.close()


@pytest.mark.parametrize(
    ("answer", "well", "words"),
    [
        (ANSWER, True, "answered: G.001.005"),
        (b"\x00\x01\xfe\xff", False, "garbage over TCP: bytes 00 01 fe ff"),
        (b'<State Mode="EXT"></State>', False, "a robot controller that sends its state over EKI"),
        (b"", False, "sends nothing"),
        (None, False, "closed as soon as it is used"),
    ],
)
def test_each_kind_of_tcp_peer_is_diagnosed(
    listener: Callable[[bytes | None], Endpoint],
    monkeypatch: pytest.MonkeyPatch,
    answer: bytes | None,
    well: bool,
    words: str,
) -> None:
    monkeypatch.setattr(line_check, "INQUIRY_LIMIT_S", 0.2)
    diagnostic = line_diagnostic(check_line(listener(answer)))
    assert diagnostic.well is well
    assert words in diagnostic.seen
    assert bool(diagnostic.advice) is not well


def test_a_robot_controller_found_without_a_theatre_file_is_no_error(
    listener: Callable[[bytes | None], Endpoint], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_check, "INQUIRY_LIMIT_S", 0.2)
    (found,) = probe.probe_endpoints([listener(b'<State Mode="EXT"></State>')], lambda _share: None)
    assert found.well
    assert found.seen == "a robot controller that sends its state over EKI"
    assert "eki_project of [robot.master]" in found.advice


def test_a_controller_that_speaks_first_is_sent_nothing() -> None:
    shown: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as peer:
                peer.sendall(b'<State Mode="EXT"></State>')
                shown.append(peer.recv(4096))

        controller = threading.Thread(target=serve)
        controller.start()
        seen = line_diagnostic(
            check_line(Endpoint("tcp", host="127.0.0.1", port=server.getsockname()[1]))
        ).seen
        controller.join()
    assert shown == [b""]
    assert "a robot controller that sends its state over EKI" in seen


def test_an_address_where_nothing_listens_is_reported() -> None:
    diagnostic = line_diagnostic(check_line(Endpoint("tcp", host="127.0.0.1", port=1)))
    assert not diagnostic.well
    assert "Nothing listens" in diagnostic.advice


# --- the diagnostics --------------------------------------------------------------------------------------


def test_the_document_lists_every_attempt_in_hex(other_end: Callable[[Hears], OtherEnd]) -> None:
    end = other_end(unit_at(115200, b"\xfe\xff"))
    diagnostic = line_diagnostic(check_line(end.endpoint))
    assert (diagnostic.subject, diagnostic.section) == (f"line serial://{end.path}", "lines")
    assert diagnostic.document is not None
    assert diagnostic.document["answered_at_baud"] == 115200
    assert [attempt["outcome"] for attempt in diagnostic.document["attempts"]] == ["garbage", "answered"]
    assert diagnostic.document["attempts"][0]["bytes"] == "fe ff"
    assert diagnostic.document["last_bytes"] == ANSWER.hex(" ")


def test_a_line_that_was_not_opened_has_no_attempts() -> None:
    diagnostic = line_diagnostic(LineState(Endpoint("tcp", host="127.0.0.1", port=1), LineOpening.MISSING))
    assert diagnostic.document is not None
    assert diagnostic.document["attempts"] == []


def test_the_cause_found_on_the_line_becomes_the_advice_for_the_device() -> None:
    shares: list[float] = []
    config = DeviceConfig(driver="ndi_polaris", endpoint="serial:///dev/no-such-port")
    line_seen, device = probe("tracker", config, shares.append)
    assert shares == [0.5]
    assert line_seen.subject == "line serial:///dev/no-such-port"
    assert device.subject == "device tracker"
    assert "NDI-001" in device.seen
    assert device.advice == line_seen.advice


def test_a_line_that_does_not_exist_is_named_with_the_ports_that_do(monkeypatch: pytest.MonkeyPatch) -> None:
    port = SimpleNamespace(device="/dev/ttyUSB0")
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    lines = (parse_endpoint("serial:///dev/ttyUSB99"),)
    (missing,) = probe.find(Search(lines=lines), lambda share: None)
    assert missing.absent == ("/dev/ttyUSB99 does not exist; the serial ports of this computer: /dev/ttyUSB0")
    assert missing.endpoints == {ONLY: "serial:///dev/ttyUSB99"}
