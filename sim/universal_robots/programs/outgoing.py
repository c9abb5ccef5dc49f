"""Connections that a program opens: the robot dials, and reads once per cycle.

Only this computer is dialled.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from ipaddress import IPv4Address
from struct import Struct
from typing import Final

from sim.world.client_sockets import receive_waiting

DIAL_ATTEMPTS: Final = 5
DIAL_PAUSE_S: Final = 0.2  # between two attempts


class Outgoing:
    """One connection to a listening client. A program never waits in it: it asks again in the next cycle."""

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._received = b""
        self.cut = False  # fault: nothing passes

    @property
    def is_open(self) -> bool:
        """Whether more can arrive, or can be sent."""
        return self._socket is not None

    def dial(self, host: str, port: int, cycle_s: float) -> Iterator[None]:
        """Try several times to connect; `is_open` says whether one attempt succeeded."""
        for _ in range(DIAL_ATTEMPTS if is_this_computer(host) else 0):
            client = _begin_to_connect(host, port)
            try:
                for _ in range(round(DIAL_PAUSE_S / cycle_s)):
                    if not self.cut and _is_connected(client):
                        self._socket = client
                        return
                    yield
            finally:
                if self._socket is not client:
                    client.close()

    def take(self, layout: Struct) -> tuple[int, ...] | None:
        """Return the next message, or None if it has not arrived whole."""
        if self.cut:
            return None
        if len(self._received) < layout.size:
            self._read()
        if len(self._received) < layout.size:
            return None
        message, self._received = self._received[: layout.size], self._received[layout.size :]
        return layout.unpack(message)

    def take_all(self) -> bytes:
        """Return the bytes that have arrived."""
        if self.cut:
            return b""
        self._read()
        data, self._received = self._received, b""
        return data

    def _read(self) -> None:
        if self._socket is None:
            return
        if (data := receive_waiting(self._socket)) is None:
            return
        if not data:
            self.close()
        self._received += data

    def send(self, data: bytes) -> None:
        """Send, or close the connection if the client does not read."""
        if self._socket is None or self.cut:
            return
        try:
            if self._socket.send(data) == len(data):
                return
        except OSError:
            pass
        self.close()

    def close(self) -> None:
        """Close the connection; safe to call twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _begin_to_connect(host: str, port: int) -> socket.socket:
    client = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    client.setblocking(False)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with contextlib.suppress(OSError):  # it goes on in the background, or nobody listens
        client.connect((host, port))
    return client


def _is_connected(client: socket.socket) -> bool:
    try:
        client.getpeername()
    except OSError:
        return False
    return True


def is_this_computer(host: str) -> bool:
    """Whether an address is one of this computer alone."""
    try:
        return IPv4Address(host).is_loopback
    except ValueError:
        return False
