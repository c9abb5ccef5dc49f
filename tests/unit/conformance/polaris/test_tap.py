"""The tap changes one requested reply as a whole, and passes everything else."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

import pytest

from conformance.polaris.client import with_crc
from conformance.polaris.tap import PolarisTap
from ronna_hw.endpoints import Endpoint, parse_endpoint

BINARY = bytes.fromhex("C4A5 0D00 2983 01 0102 31000000 2D010000 0000 9E7D")


def answer(command: bytes) -> tuple[bytes, ...]:
    """BX by a binary reply in two pieces, everything else by OKAY."""
    return (BINARY[:9], BINARY[9:]) if command.startswith(b"BX") else (with_crc("OKAY"),)


@pytest.fixture
def tap(serve: Callable[..., Endpoint]) -> Iterator[PolarisTap]:
    with PolarisTap(serve(answer)) as tap:
        yield tap


@pytest.fixture
def client(tap: PolarisTap) -> Iterator[socket.socket]:
    address = parse_endpoint(tap.endpoint)
    with socket.create_connection((address.host, address.port)) as client:
        client.settimeout(10.0)
        yield client


def ask(client: socket.socket, command: bytes, length: int) -> bytes:
    client.sendall(command)
    heard = b""
    while len(heard) < length:
        heard += client.recv(4096)
    return heard


def test_commands_in_both_formats_are_recorded(tap: PolarisTap, client: socket.socket) -> None:
    ask(client, b"PHSR:0020FF\r", 9)
    ask(client, b"TSTART 80\r", 9)
    assert tap.commands == ["PHSR:00", "TSTART:80"]
    assert tap.count("TSTART") == 1
    assert tap.replies["PHSR"] == with_crc("OKAY")


def test_the_next_reply_to_a_command_is_changed_once(tap: PolarisTap, client: socket.socket) -> None:
    tap.answer("PINIT", "WARNING05")
    assert ask(client, b"PENA 01D\r", 9) == with_crc("OKAY")
    assert ask(client, b"PINIT 01\r", 13) == with_crc("WARNING05")
    assert ask(client, b"PINIT 01\r", 9) == with_crc("OKAY")


def test_a_binary_reply_is_changed_as_a_whole(tap: PolarisTap, client: socket.socket) -> None:
    got: list[bytes] = []

    def change(reply: bytes) -> bytes:
        got.append(reply)
        return b"changed"

    tap.change("BX", change)
    assert ask(client, b"BX 0001\r", 7) == b"changed"
    assert got == [BINARY]
    assert ask(client, b"BX 0001\r", len(BINARY)) == BINARY


def test_the_tap_injects_bytes_that_the_unit_never_sent(tap: PolarisTap, client: socket.socket) -> None:
    ask(client, b"PENA 01D\r", 9)
    tap.inject(b"RESETBE6F\r")
    assert client.recv(100) == b"RESETBE6F\r"
