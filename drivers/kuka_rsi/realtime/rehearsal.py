"""A dry run of receiving and sending, so that the code path of the next cycle is in the caches."""

from __future__ import annotations

import contextlib
import socket

from drivers.kuka_rsi.realtime.telegram import LONGEST_TELEGRAM


class Rehearsal:
    """A socket connected to itself on loopback; nothing leaves this machine."""

    def __init__(self) -> None:
        self._own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._own.bind(("127.0.0.1", 0))
        self._own.connect(self._own.getsockname())

    def exchange(self, data: bytes) -> None:
        """Send and receive a datagram like the next one, through the same calls."""
        with contextlib.suppress(OSError):  # nothing depends on it
            self._own.send(data)
            self._own.recv(LONGEST_TELEGRAM, socket.MSG_DONTWAIT)

    def close(self) -> None:
        """Close the socket."""
        self._own.close()
