"""The disturbed line disturbs only what the device sends, and exactly as ordered."""

from __future__ import annotations

import os
import pty
import socket
import time
import tty
from collections.abc import Callable, Iterator

import pytest

from conformance.disturbed_line import DisturbedLine
from ronna_hw.endpoints import Endpoint, parse_endpoint


@pytest.fixture
def line(serve: Callable[..., Endpoint]) -> Iterator[DisturbedLine]:
    """A line to a device that says back what it hears."""
    with DisturbedLine(serve(lambda data: [data])) as line:
        yield line


def test_the_line_is_reached_from_this_computer_only(line: DisturbedLine) -> None:
    where = parse_endpoint(line.endpoint)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", where.port))
    socket.create_connection((where.host, where.port)).close()


def client_of(line: DisturbedLine) -> socket.socket:
    address = parse_endpoint(line.endpoint)
    client = socket.create_connection((address.host, address.port))
    client.settimeout(2.0)
    return client


def ask(client: socket.socket, data: bytes) -> bytes:
    client.sendall(data)
    return client.recv(4096)


def test_an_undisturbed_line_passes_everything_on(line: DisturbedLine) -> None:
    with client_of(line) as client:
        everything = bytes(range(256))
        assert ask(client, everything) == everything


def test_one_reply_is_corrupted_and_the_next_is_intact(line: DisturbedLine) -> None:
    with client_of(line) as client:
        ask(client, b"x")
        line.flip_next()
        assert ask(client, b"ABC") == b"ABB"
        assert ask(client, b"ABC") == b"ABC"
        line.lose_next_byte()
        assert ask(client, b"ABC") == b"AB"
        assert ask(client, b"ABC") == b"ABC"


def test_a_delayed_reply_arrives_late_and_in_order(line: DisturbedLine) -> None:
    with client_of(line) as client:
        ask(client, b"x")
        line.delay_next(0.2)
        began_s = time.monotonic()
        client.sendall(b"first")
        time.sleep(0.05)
        client.sendall(b"second")
        heard = b""
        while len(heard) < 11:
            heard += client.recv(4096)
        assert heard == b"firstsecond"
        assert time.monotonic() - began_s >= 0.2


def test_silence_drops_everything_until_it_is_switched_off(line: DisturbedLine) -> None:
    with client_of(line) as client:
        ask(client, b"x")
        line.silence()
        client.settimeout(0.2)
        with pytest.raises(TimeoutError):
            ask(client, b"lost")
        line.silence(False)
        client.settimeout(2.0)
        assert ask(client, b"heard") == b"heard"


def test_a_cut_closes_the_connection_and_the_next_one_is_served(line: DisturbedLine) -> None:
    with client_of(line) as client:
        ask(client, b"x")
        line.cut()
        assert client.recv(4096) == b""
    with client_of(line) as client:
        assert ask(client, b"again") == b"again"


def test_an_unreachable_device_ends_the_connection_without_a_crash() -> None:
    with DisturbedLine(parse_endpoint("tcp://127.0.0.1:1")) as line, client_of(line) as client:
        assert client.recv(4096) == b""


def test_a_serial_device_works_too() -> None:
    unit, terminal = pty.openpty()
    tty.setraw(terminal)
    try:
        endpoint = parse_endpoint(f"serial://{os.ttyname(terminal)}")
        with DisturbedLine(endpoint) as line, client_of(line) as client:
            client.sendall(b"INIT \r")
            assert os.read(unit, 100) == b"INIT \r"
            os.write(unit, b"OKAYA896\r")
            assert client.recv(100) == b"OKAYA896\r"
    finally:
        os.close(unit)
        os.close(terminal)
