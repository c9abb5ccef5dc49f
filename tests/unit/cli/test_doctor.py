"""The doctor: what is on a tracker's line, why nothing answers, and what to do about it."""

from __future__ import annotations

import fcntl
import json
import os
import socket
import stat
import subprocess
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from procedures.cli import line_probe
from procedures.cli.doctor import Report, examine, show
from procedures.cli.line_cause import document, judge, permission_advice, permissions
from procedures.cli.line_probe import Access, Outcome, probe_line
from ronna_hw.endpoints import BadEndpoint, Endpoint, parse_endpoint
from ronna_hw.wire.polaris import crc16

ANSWER = b"G.001.005%04X\r" % crc16(b"G.001.005")
RATES = {termios.B9600: 9600, termios.B115200: 115200, termios.B230400: 230400}
Answer = Callable[[int, bytes], bytes]  # rate of the host, what it said -> what it hears


class FarEnd:
    """The far end of a pseudo-terminal, which sees at which rate the host speaks."""

    def __init__(self, answer: Answer) -> None:
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
def far_end() -> Iterator[Callable[[Answer], FarEnd]]:
    ends: list[FarEnd] = []

    def make(answer: Answer) -> FarEnd:
        ends.append(FarEnd(answer))
        return ends[-1]

    yield make
    for end in ends:
        end.close()


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_probe, "PATIENCE_S", 0.1)
    monkeypatch.setattr(line_probe, "BAUDS", (9600, 115200, 230400))


def unit_at(baud: int, elsewhere: bytes = b"") -> Answer:
    return lambda rate, _said: ANSWER if rate == baud else elsewhere


def test_a_unit_at_the_rate_of_power_up_answers(far_end: Callable[[Answer], FarEnd]) -> None:
    probe = probe_line(far_end(unit_at(9600)).endpoint)
    verdict = judge(probe)
    assert (verdict.well, verdict.advice) == (True, "")
    assert verdict.seen == f"answered at 9600: G.001.005 (last bytes {ANSWER.hex(' ')})"
    assert len(probe.attempts) == 1
    assert probe.last_bytes == ANSWER


@pytest.mark.parametrize("elsewhere", [b"", b"\x80\xff\x00"])
def test_a_unit_left_at_another_rate_is_found_there(
    far_end: Callable[[Answer], FarEnd], elsewhere: bytes
) -> None:
    probe = probe_line(far_end(unit_at(115200, elsewhere)).endpoint)
    verdict = judge(probe)
    assert verdict.well
    assert verdict.seen.startswith("answered at 115200: G.001.005")
    assert "An earlier program left it at this rate" in verdict.advice
    assert [attempt.baud for attempt in probe.attempts] == [9600, 115200]


def test_garbage_is_shown_in_hex_with_its_rate(far_end: Callable[[Answer], FarEnd]) -> None:
    probe = probe_line(far_end(lambda rate, _: b"\x80\xf8\x00\xe6" if rate == 9600 else b"").endpoint)
    verdict = judge(probe)
    assert not verdict.well
    assert verdict.seen == "garbage at 9600: bytes 80 f8 00 e6"
    assert "Probably another rate, or another device" in verdict.advice
    assert [attempt.outcome for attempt in probe.attempts] == [
        Outcome.GARBAGE, Outcome.SILENCE, Outcome.SILENCE
    ]  # fmt: skip


def test_another_device_that_speaks_text_is_quoted(far_end: Callable[[Answer], FarEnd]) -> None:
    verdict = judge(probe_line(far_end(lambda _rate, _said: b"\r\nlogin: ").endpoint))
    assert "'login:'" in verdict.advice


def test_a_loop_back_is_known(far_end: Callable[[Answer], FarEnd]) -> None:
    verdict = judge(probe_line(far_end(lambda _rate, said: said).endpoint))
    assert not verdict.well
    assert "gives back what we send" in verdict.seen


def test_a_spoilt_first_question_is_asked_again(far_end: Callable[[Answer], FarEnd]) -> None:
    answers = iter([b"\xff\xfe", ANSWER])
    probe = probe_line(far_end(lambda _rate, _said: next(answers)).endpoint)
    assert probe.answered is not None
    assert probe.answered.baud == 9600


def test_a_silent_line_names_the_rates_that_were_tried(far_end: Callable[[Answer], FarEnd]) -> None:
    end = far_end(lambda _rate, _said: b"")
    verdict = judge(probe_line(end.endpoint))
    assert verdict.seen == "silent at 9600, 115200, 230400 baud"
    assert "powered" in verdict.advice
    assert [rate for rate, _ in end.heard] == [9600, 115200, 230400]
    assert {said for _, said in end.heard} == {b"APIREV:443E\r"}


@pytest.fixture
def other_program(far_end: Callable[[Answer], FarEnd]) -> Iterator[tuple[FarEnd, int]]:
    """(line, pid) of a program that has the line open."""
    end = far_end(unit_at(9600))
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


def test_another_program_is_named_and_its_line_left_alone(other_program: tuple[FarEnd, int]) -> None:
    end, pid = other_program
    probe = probe_line(end.endpoint)
    verdict = judge(probe)
    assert not verdict.well
    assert verdict.seen.startswith("held by another program: ")
    assert f"(pid {pid})" in verdict.seen
    assert end.heard == []


def test_a_lock_whose_holder_cannot_be_seen_is_told_as_one(
    far_end: Callable[[Answer], FarEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = far_end(unit_at(9600))
    monkeypatch.setattr(line_probe, "users_of_serial_port", lambda _path: ())
    locked = os.open(end.path, os.O_RDWR | os.O_NOCTTY)
    try:
        fcntl.flock(locked, fcntl.LOCK_EX)
        verdict = judge(probe_line(end.endpoint))
    finally:
        os.close(locked)
    assert "held by another program, which this user may not see" in verdict.seen
    assert f"sudo fuser -v {end.path}" in verdict.advice


def test_a_missing_permission_names_the_group(
    far_end: Callable[[Answer], FarEnd], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = far_end(unit_at(9600))
    monkeypatch.setattr(line_probe.os, "access", lambda _path, _mode: False)
    probe = probe_line(end.endpoint)
    assert probe.access is Access.FORBIDDEN
    verdict = judge(probe)
    assert verdict.seen == f"permission denied: {end.path}"
    assert end.heard == []


def test_the_group_that_may_use_a_port_is_told(tmp_path: Path) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    port.chmod(stat.S_IRUSR | stat.S_IWUSR | stat.S_IRGRP | stat.S_IWGRP)
    assert "sudo usermod -aG " in permission_advice(str(port))
    assert permissions(str(port)).startswith("-rw-rw---- ")
    port.chmod(stat.S_IRUSR)
    assert "udev" in permission_advice(str(port))
    assert "dialout" in permission_advice("/dev/no-such-port")


def test_a_port_that_does_not_exist() -> None:
    verdict = judge(probe_line(Endpoint("serial", path="/dev/no-such-port")))
    assert "does not exist" in verdict.seen


# --- TCP ---------------------------------------------------------------------------------------------------


@pytest.fixture
def listener() -> Iterator[Callable[[bytes | None], Endpoint]]:
    """A TCP port that answers everything with the same bytes, or hangs up when they are None."""
    servers: list[socket.socket] = []

    def make(answer: bytes | None) -> Endpoint:
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)

        def serve() -> None:
            try:
                peer, _ = server.accept()
            except OSError:
                return
            with peer:
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
        (b"", False, "says nothing"),
        (None, False, "closed as soon as it is used"),
    ],
)
def test_what_answers_over_tcp(
    listener: Callable[[bytes | None], Endpoint],
    monkeypatch: pytest.MonkeyPatch,
    answer: bytes | None,
    well: bool,
    words: str,
) -> None:
    monkeypatch.setattr(line_probe, "TCP_PATIENCE_S", 0.2)
    verdict = judge(probe_line(listener(answer)))
    assert verdict.well is well
    assert words in verdict.seen
    assert bool(verdict.advice) is not well


def test_nobody_listens() -> None:
    verdict = judge(probe_line(Endpoint("tcp", host="127.0.0.1", port=1)))
    assert not verdict.well
    assert "Nothing listens" in verdict.advice


# --- the report --------------------------------------------------------------------------------------------


def test_the_report_in_json_has_every_attempt_in_hex(
    far_end: Callable[[Answer], FarEnd], capsys: pytest.CaptureFixture[str]
) -> None:
    end = far_end(unit_at(115200, b"\xfe\xff"))
    show(examine(None, [str(end.endpoint)]), as_json=True)
    report = json.loads(capsys.readouterr().out)
    (line,) = report["lines"]
    assert line["answered_at_baud"] == 115200
    assert [attempt["outcome"] for attempt in line["attempts"]] == ["garbage", "answered"]
    assert line["attempts"][0]["bytes"] == "fe ff"
    assert line["last_bytes"] == ANSWER.hex(" ")
    assert report["findings"][-1]["subject"] == f"line serial://{end.path}"


def test_a_line_that_does_not_answer_ends_with_4(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        show(examine(None, ["tcp://127.0.0.1:1"]), as_json=False)
    assert ended.value.code == 4
    assert "line tcp://127.0.0.1:1\tlook\tconnection refused" in capsys.readouterr().out


def test_an_endpoint_of_another_kind_is_refused() -> None:
    with pytest.raises(BadEndpoint):
        examine(None, ["udp://127.0.0.1:59152"])


def test_the_tracker_of_a_theatre_file_is_probed_and_its_cause_is_told(
    far_end: Callable[[Answer], FarEnd], tmp_path: Path
) -> None:
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "serial:///dev/no-such-port"\n'
    )
    shares: list[float] = []
    report: Report = examine(path, (), shares.append)
    assert shares == [0.5, 1.0]
    line, device = report.findings[-2:]
    assert line.subject == "line serial:///dev/no-such-port"
    assert device.subject == "device tracker"
    assert "NDI-001" in device.seen
    assert device.advice == line.advice


def test_a_computer_alone_is_well_without_devices() -> None:
    report = examine(None)
    assert report.lines == ()
    assert not [finding for finding in report.findings if finding.subject.startswith(("line", "device"))]
    assert document(probe_line(Endpoint("tcp", host="127.0.0.1", port=1)))["attempts"] == []
