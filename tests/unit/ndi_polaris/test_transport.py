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

import pytest
import serial

from drivers.ndi_polaris.errors import LinkLost, PortUnavailable
from drivers.ndi_polaris.transport import SerialTransport, TcpTransport, Transport, open_transport
from ronna_hw.endpoints import Endpoint, parse_endpoint


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


@pytest.fixture
def port() -> Iterator[tuple[Endpoint, int]]:
    """Open a pseudo-terminal; return its endpoint and the unit's end."""
    unit, terminal = pty.openpty()
    yield parse_endpoint(f"serial://{os.ttyname(terminal)}"), unit
    os.close(unit)
    os.close(terminal)


def test_a_serial_line_can_change_its_rate_and_send_a_break(port: tuple[Endpoint, int]) -> None:
    endpoint, unit = port
    transport = SerialTransport(endpoint)
    assert transport.baud == 9600
    transport.set_baud(115200)
    assert transport.baud == 115200
    with pytest.raises(PortUnavailable):
        transport.set_baud(-1)
    os.write(unit, b"before the break")
    transport.send_break()
    assert transport.read(0.0) == b""
    transport.close()


def test_an_adapter_has_low_latency_and_its_break_lasts_500_ms(
    port: tuple[Endpoint, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    breaks: list[int] = []
    said: list[bool] = []
    monkeypatch.setattr(termios, "tcsendbreak", lambda _file, duration_ms: breaks.append(duration_ms))
    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", lambda _port, wanted: said.append(wanted))
    transport = SerialTransport(port[0])
    transport.send_break()
    transport.close()
    assert (said, breaks) == ([True], [500])


def test_tcp_has_no_rate_and_no_break() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        transport = TcpTransport(parse_endpoint(f"tcp://127.0.0.1:{server.getsockname()[1]}"), 1.0)
        transport.set_baud(9600)
        transport.send_break()
        assert transport.baud is None
        transport.close()


def test_the_program_that_holds_a_serial_port_is_named(port: tuple[Endpoint, int]) -> None:
    endpoint, _ = port
    hold = "import serial, sys; port = serial.Serial(sys.argv[1], exclusive=True); print(flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", hold, endpoint.path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(PortUnavailable, match=rf"held by another program, .* \(pid {holder.pid}\)"):
            SerialTransport(endpoint)
        holder.communicate(b"\n")
