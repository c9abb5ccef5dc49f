"""Bytes over a real pseudo-terminal and a real TCP connection."""

from __future__ import annotations

import os
import pty
import socket
import subprocess
import sys
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from drivers.ndi_polaris.errors import LinkLost, PortUnavailable
from drivers.ndi_polaris.transport import SerialTransport, TcpTransport, Transport, open_transport
from ronna_hw.endpoints import BadEndpoint, parse_endpoint


class Line:
    """Both ends of one line."""

    def __init__(self, transport: Transport, unit: int | socket.socket, endpoint: str) -> None:
        self.transport, self.unit, self.endpoint = transport, unit, endpoint

    def send(self, data: bytes) -> None:
        if isinstance(self.unit, int):
            os.write(self.unit, data)
        else:
            self.unit.sendall(data)

    def receive(self) -> bytes:
        return os.read(self.unit, 4096) if isinstance(self.unit, int) else self.unit.recv(4096)

    def hang_up(self) -> None:
        if isinstance(self.unit, int):
            os.close(self.unit)
        else:
            self.unit.close()


@pytest.fixture(params=["serial", "tcp"])
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    if request.param == "serial":
        unit, terminal = pty.openpty()
        tty.setraw(terminal)
        endpoint = f"serial://{os.ttyname(terminal)}"
        line = Line(open_transport(parse_endpoint(endpoint), 1.0), unit, endpoint)
        os.close(terminal)
        yield line
    else:
        with socket.create_server(("127.0.0.1", 0)) as server:
            endpoint = f"tcp://127.0.0.1:{server.getsockname()[1]}"
            transport = open_transport(parse_endpoint(endpoint), 1.0)
            line = Line(transport, server.accept()[0], endpoint)
            yield line
    line.transport.close()
    try:
        line.hang_up()
    except OSError:
        assert isinstance(line.unit, int)  # the test hung up itself


def test_bytes_pass_both_ways_unchanged(line: Line) -> None:
    everything = bytes(range(256))
    line.transport.write(everything)
    assert line.receive() == everything
    line.send(everything)
    heard = b""
    while len(heard) < 256:
        heard += line.transport.read(1.0)
    assert heard == everything


def test_a_read_without_input_returns_no_bytes(line: Line) -> None:
    assert line.transport.read(0.0) == b""
    assert line.transport.read(0.01) == b""


def test_a_line_that_hangs_up_raises_link_lost(line: Line) -> None:
    line.hang_up()
    with pytest.raises(LinkLost):
        line.transport.read(1.0)


def test_closing_twice_raises_nothing(line: Line) -> None:
    line.transport.close()
    line.transport.close()


def test_a_write_to_a_dead_line_does_not_block_forever(line: Line) -> None:
    with pytest.raises(LinkLost):
        line.transport.write(bytes(50_000_000))  # nobody reads at the other end


def test_a_serial_line_can_change_its_rate_and_send_a_break() -> None:
    unit, terminal = pty.openpty()
    try:
        transport = SerialTransport(parse_endpoint(f"serial://{os.ttyname(terminal)}"))
        assert transport.baud == 9600
        transport.set_baud(115200)
        assert transport.baud == 115200
        with pytest.raises(PortUnavailable):
            transport.set_baud(-1)
        os.write(unit, b"before the break")
        transport.send_break()
        assert transport.read(0.0) == b""
        transport.close()
    finally:
        os.close(unit)
        os.close(terminal)


def test_a_break_lasts_500_ms(monkeypatch: pytest.MonkeyPatch) -> None:
    unit, terminal = pty.openpty()
    breaks: list[int] = []
    monkeypatch.setattr(termios, "tcsendbreak", lambda _file, duration_ms: breaks.append(duration_ms))
    transport = SerialTransport(parse_endpoint(f"serial://{os.ttyname(terminal)}"))
    transport.send_break()
    assert breaks == [500]
    transport.close()
    os.close(unit)
    os.close(terminal)


def test_a_usb_adapter_is_set_to_low_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    unit, terminal = pty.openpty()
    said: list[bool] = []
    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", lambda _port, wanted: said.append(wanted))
    SerialTransport(parse_endpoint(f"serial://{os.ttyname(terminal)}")).close()
    assert said == [True]
    os.close(unit)
    os.close(terminal)


@pytest.mark.hazard(34)
def test_a_serial_port_is_exclusive_to_one_client() -> None:
    unit, terminal = pty.openpty()
    endpoint = parse_endpoint(f"serial://{os.ttyname(terminal)}")
    first = SerialTransport(endpoint)
    try:
        with pytest.raises(PortUnavailable):
            SerialTransport(endpoint)
    finally:
        first.close()
        os.close(unit)
        os.close(terminal)


def test_tcp_has_no_rate_and_no_break() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = TcpTransport(parse_endpoint(f"tcp://127.0.0.1:{server.getsockname()[1]}"), 1.0)
        transport.set_baud(9600)
        transport.send_break()
        assert transport.baud is None
        transport.close()


def test_an_endpoint_that_cannot_be_opened_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(PortUnavailable, match="no such file"):
        open_transport(parse_endpoint(f"serial://{tmp_path}/none"), 1.0)
    with pytest.raises(PortUnavailable, match="refused"):
        open_transport(parse_endpoint("tcp://127.0.0.1:1"), 1.0)
    with pytest.raises(BadEndpoint):
        open_transport(parse_endpoint("udp://127.0.0.1:1"), 1.0)


def test_the_program_that_holds_a_serial_port_is_named() -> None:
    unit, terminal = pty.openpty()
    path = os.ttyname(terminal)
    hold = "import serial, sys; port = serial.Serial(sys.argv[1], exclusive=True); print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", hold, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(PortUnavailable, match=rf"held by another program, .* \(pid {holder.pid}\)"):
            SerialTransport(parse_endpoint(f"serial://{path}"))
        holder.communicate(b"\n")
    os.close(unit)
    os.close(terminal)
