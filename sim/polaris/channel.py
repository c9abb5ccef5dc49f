"""The byte streams to a host: a pseudo-terminal, or one TCP connection. Both are written without blocking."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import termios
import time
import tty
from typing import Protocol

from ronna_hw.wire.polaris import BITS_PER_BYTE_ON_LINE

RECEIVE_BYTES = 4096
FULL_PATIENCE_S = 0.5  # a serial line waits for nobody: what the host does not take in this time is lost
SEND_PATIENCE_S = 5.0  # a host that reads nothing for so long is gone
THROTTLE_STEP_S = 0.01  # a throttled reply trickles in steps as long as this
_TERMIOS_INPUT_SPEED, _TERMIOS_OUTPUT_SPEED = 4, 5


class Channel(Protocol):
    """A stream to one host."""

    def fileno(self) -> int:
        """File descriptor to wait on."""
        ...

    def receive(self) -> bytes:
        """What has arrived; empty when the host is gone for good."""
        ...

    def send(self, data: bytes, received_bytes: int, baud: int) -> None:
        """Send a reply to a command of `received_bytes`; `baud` matters only to a throttled line."""
        ...


class PseudoTerminal:
    """A serial line. The unit keeps its far end open, so that hosts may come, go, and be killed."""

    def __init__(self, *, throttle: bool) -> None:
        self._throttle = throttle
        self._master, self._far_end = os.openpty()
        tty.setraw(self._far_end)
        settings = termios.tcgetattr(self._far_end)
        settings[_TERMIOS_INPUT_SPEED] = settings[_TERMIOS_OUTPUT_SPEED] = termios.B9600
        termios.tcsetattr(self._far_end, termios.TCSANOW, settings)
        os.set_blocking(self._master, False)

    @property
    def endpoint(self) -> str:
        """Where hosts open the line."""
        return f"serial://{os.ttyname(self._far_end)}"

    def fileno(self) -> int:
        return self._master

    def receive(self) -> bytes:
        return os.read(self._master, RECEIVE_BYTES)

    def send(self, data: bytes, received_bytes: int, baud: int) -> None:
        if not self._throttle:
            self._write(data)
            return
        seconds_per_byte = BITS_PER_BYTE_ON_LINE / baud
        moment = time.monotonic() + received_bytes * seconds_per_byte
        step = max(1, int(THROTTLE_STEP_S / seconds_per_byte))
        for start in range(0, len(data), step):
            piece = data[start : start + step]
            moment += len(piece) * seconds_per_byte
            time.sleep(max(0.0, moment - time.monotonic()))
            self._write(piece)

    def _write(self, data: bytes) -> None:
        deadline = 0.0
        while data:
            try:
                data = data[os.write(self._master, data) :]
            except BlockingIOError:
                now = time.monotonic()
                deadline = deadline or now + FULL_PATIENCE_S
                if now >= deadline:
                    return
                select.select([], [self._master], [], deadline - now)

    def close(self) -> None:
        """Give the line up."""
        os.close(self._master)
        os.close(self._far_end)


class Connection:
    """One TCP connection."""

    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.settimeout(SEND_PATIENCE_S)

    def fileno(self) -> int:
        return self._peer.fileno()

    def receive(self) -> bytes:
        try:
            return self._peer.recv(RECEIVE_BYTES)
        except OSError:
            return b""

    def send(self, data: bytes, received_bytes: int, baud: int) -> None:
        try:
            self._peer.sendall(data)
        except OSError:  # half a reply is worth nothing: the next receive tells that the host is gone
            with contextlib.suppress(OSError):
                self._peer.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Hang up."""
        self._peer.close()
