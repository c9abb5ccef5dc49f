"""The byte stream to a host; writing never blocks for long."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Sequence
from typing import Protocol

from sim.polaris.line.line_settings import LineSettings

RECEIVE_BYTES = 4096
Ready = Sequence[tuple[int, int]]  # (file descriptor, events) as `poll` returns them
SEND_PATIENCE_S = 5.0  # a host that has read nothing for this long is gone, whatever the unit's own limit


class Channel(Protocol):
    """A byte stream to one host."""

    def files(self) -> tuple[int, ...]:
        """File descriptors to wait on."""
        ...

    def receive(self, ready: Ready) -> bytes | None:
        """Bytes from the ready descriptors, possibly none; None when the host is gone."""
        ...

    def let_arrive(self, received_bytes: int, line: LineSettings) -> None:
        """Wait for the time that this many bytes take on a line with these settings."""
        ...

    def send(self, data: bytes, line: LineSettings) -> None:
        """Send a reply with these line settings."""
        ...


class Connection:
    """One TCP connection, without line settings; a host that accepts no reply for `patience_s` is gone."""

    def __init__(self, peer: socket.socket, patience_s: float) -> None:
        self._peer = peer
        self._gone = False
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.settimeout(min(patience_s, SEND_PATIENCE_S))

    def files(self) -> tuple[int, ...]:
        return (self._peer.fileno(),)

    def receive(self, ready: Ready) -> bytes | None:
        if self._gone:  # whatever it had still sent is not executed
            return None
        try:
            return self._peer.recv(RECEIVE_BYTES) or None
        except OSError:
            return None

    def let_arrive(self, received_bytes: int, line: LineSettings) -> None:
        """A network has no baud rate: no wait."""

    def send(self, data: bytes, line: LineSettings) -> None:
        try:
            self._peer.sendall(data)
        except OSError:  # half a reply is useless: make the next receive report the host as gone
            self._gone = True
            with contextlib.suppress(OSError):
                self._peer.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Hang up."""
        self._peer.close()
