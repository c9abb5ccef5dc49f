"""The EKI channel loop: one telegram read and one written per loop, and a buffer that can overflow."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from time import process_time
from typing import Any
from xml.etree import ElementTree

import pytest

from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.kuka_eki import STATE_PERIOD_MS
from sim.errors import EndpointTaken
from sim.kuka.autostart import Autostart
from sim.kuka.eki import server as eki_server
from sim.kuka.eki.project_channel import ProjectChannel
from sim.kuka.eki.sdk_channel import SdkChannel
from sim.kuka.eki.server import (
    GARBAGE,
    PADDING,
    UNREAD_LIMIT,
    EkiServer,
    halve,
    pad_with_nul,
    prepend_garbage,
    split_requests,
)
from sim.world.client_sockets import READ_BYTES

LOOP_S = 0.012


class Time:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


class Program:
    """Keeps what it has read."""

    def __init__(self) -> None:
        self.read: list[str] = []
        self.gone = False

    def client_connected(self) -> None:
        self.read.clear()

    def request(self, element: ElementTree.Element) -> None:
        self.read.append(element.get("Id", ""))

    def client_disconnected(self) -> None:
        self.gone = True


class Line:
    """A server in loops of 12 ms, its program, and a client."""

    def __init__(self, time: Time) -> None:
        self.time = time
        self.program = Program()
        self.server = EkiServer(Endpoint("tcp", "127.0.0.1", 0), LOOP_S)
        self.server.attach(self.program)
        host, port = self.server.endpoint.removeprefix("tcp://").split(":")
        self.client = socket.create_connection((host, int(port)), timeout=10.0)
        self.serve()
        self.client.setblocking(False)

    def serve(self) -> None:
        for ready in self.server.sockets:
            self.server.serve(ready)

    def say(self, *identifiers: int) -> None:
        self.client.setblocking(True)
        self.client.sendall(b"".join(b'<Cmd Id="%d"/>' % n for n in identifiers))
        self.client.setblocking(False)
        self.serve()

    def loop(self) -> None:
        self.time.now_s += LOOP_S
        self.server.flush()

    def heard(self) -> bytes:
        try:
            return self.client.recv(65536)
        except BlockingIOError:
            return b""


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    time = Time()
    monkeypatch.setattr(eki_server, "time", time)
    line = Line(time)
    yield line
    line.client.close()
    line.server.close()


def test_one_telegram_is_written_per_loop_and_never_two_in_one_segment(line: Line) -> None:
    for number in range(3):
        line.server.send(f"<Robot>{number}</Robot>")
    assert line.heard() == b""
    for number in range(3):
        line.loop()
        assert line.heard() == b"<Robot>%d</Robot>" % number
    line.loop()
    assert line.heard() == b""


def test_one_request_is_read_per_loop_and_the_others_wait(line: Line) -> None:
    line.say(1, 2, 3)
    assert line.program.read == ["1"]
    assert line.server.due_s == pytest.approx(line.time.now_s + LOOP_S)
    line.loop()
    assert line.program.read == ["1", "2"]
    line.loop()
    assert line.program.read == ["1", "2", "3"]
    assert line.server.due_s is None


def test_a_buffer_of_512_unread_requests_overflows_and_closes_the_connection(line: Line) -> None:
    line.server.silent = True
    line.say(*range(UNREAD_LIMIT))
    assert line.server.connected
    line.say(9999)
    assert not line.server.connected
    assert line.program.gone
    assert line.program.read == []
    assert line.heard() == b""  # an orderly end


def test_requests_to_a_silent_program_are_kept_until_it_reads_again(line: Line) -> None:
    line.server.silent = True
    line.say(1, 2)
    line.server.send("<Robot>unheard</Robot>")
    line.loop()
    assert (line.program.read, line.heard()) == ([], b"")
    line.server.silent = False
    line.loop()
    line.loop()
    assert line.program.read == ["1", "2"]


def test_the_half_telegram_fault_spoils_only_one_telegram(line: Line) -> None:
    line.server.corrupt_next(halve)
    for _ in range(2):
        line.server.send("<Robot></Robot>")
        line.loop()
    assert line.heard() == b"<Robot><Robot></Robot>"


@pytest.mark.parametrize(
    ("how", "written"),
    [
        (prepend_garbage, GARBAGE + b"<Robot></Robot>"),
        (pad_with_nul, PADDING + b"<Robot></Robot>" + PADDING),
    ],
)
def test_the_garbage_and_padding_faults_spoil_only_one_telegram(
    line: Line, how: Callable[[bytes], bytes], written: bytes
) -> None:
    assert b"<" not in GARBAGE
    line.server.corrupt_next(how)
    for _ in range(2):
        line.server.send("<Robot></Robot>")
        line.loop()
    assert line.heard() == written + b"<Robot></Robot>"


def test_an_occupied_channel_refuses_another_client_and_keeps_its_own(line: Line) -> None:
    line.server.occupied = True
    host, port = line.server.endpoint.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=10.0) as other:
        line.serve()
        assert other.recv(1) == b""
    line.say(1)
    assert line.program.read == ["1"]


def test_a_request_to_a_full_buffer_closes_the_connection(line: Line) -> None:
    line.server.fill_buffer()
    assert line.server.connected
    line.say(1)
    assert not line.server.connected
    assert line.program.read == []


@pytest.mark.parametrize(
    ("kind", "period_s", "element"),
    [(SdkChannel, 1.0, b"<Status "), (ProjectChannel, STATE_PERIOD_MS / 5000.0, b"<State ")],
)
def test_a_client_receives_the_state_once_and_again_as_soon_as_it_changes(
    line: Line, make_bench: Callable[..., Any], kind: Any, period_s: float, element: bytes
) -> None:
    controller = make_bench(start=False).controller
    channel = kind(line.server, controller, Autostart(controller, is_requested=False))
    said = []
    for change in (lambda: None, lambda: None, lambda: controller.open_guard(True), lambda: None):
        change()
        line.time.now_s += period_s  # the project's channel repeats an unchanged state later
        channel.tick(line.time.now_s)
        line.loop()
        said.append(line.heard().count(element))
    assert said == [1, 0, 1, 0]


@pytest.mark.parametrize("tail", [b"9", b"a ", b"'", b'"', b"/", b"<a ", b"<a>", b'<a "'])
def test_an_unterminated_request_is_scanned_in_bounded_time(tail: bytes) -> None:
    began_s = process_time()
    found, _ = split_requests(b'<Cmd Id="1"></Cmd><Cmd' + tail * (READ_BYTES // len(tail)))
    assert found == [b'<Cmd Id="1"></Cmd>']
    assert process_time() - began_s < 1.0


def test_a_port_conflict_names_the_process_holding_the_port_and_suggests_a_free_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = Endpoint("tcp", "127.0.0.1", other.getsockname()[1])
        with pytest.raises(EndpointTaken, match=rf"in use by .*\(pid {os.getpid()}\)") as refused:
            EkiServer(address)
    assert refused.value.code == "SIM-004"
    assert "--eki-project tcp://127.0.0.1:0" in refused.value.advice
