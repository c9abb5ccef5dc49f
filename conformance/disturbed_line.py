"""Fault-injecting TCP line between a driver and its device.

It changes only what the device sends, never what the driver sends, so it is safe to use with hardware.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self

from ronna_hw.endpoints import Endpoint

CHUNK_BYTES = 65536
OPEN_TIMEOUT_S = 5.0
POLL_S = 0.02  # how often the thread checks whether to end

Disturbance = Callable[[bytes], list[tuple[float, bytes]]]  # one chunk -> (delay in seconds, bytes), in order


class _End(Protocol):
    def fileno(self) -> int: ...
    def close(self) -> None: ...


class LineThread(ABC):
    """Context manager that runs `_serve` in a thread; setting `_ended` stops it."""

    def __init__(self, name: str) -> None:
        self._ended = False
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        self._thread.join()
        self._close()

    @abstractmethod
    def _serve(self) -> None:
        """Forward bytes until `_ended` is set."""

    @abstractmethod
    def _close(self) -> None:
        """Close the sockets after the thread has ended."""


class DisturbedLine(LineThread):
    """Fault-injecting line for one client at a time, as a context manager."""

    def __init__(self, device: Endpoint) -> None:
        super().__init__("disturbed line")
        self._device = device.require("tcp", "igtl", "serial")
        self._server = socket.create_server(("127.0.0.1", 0))
        self._next: Disturbance | None = None
        self._injected: list[bytes] = []
        self._silent = False
        self._cut = False

    @property
    def endpoint(self) -> str:
        return f"tcp://127.0.0.1:{self._server.getsockname()[1]}"

    def flip_next(self) -> None:
        """Flip one bit in the next chunk that the device sends."""
        self._next = lambda data: [(0.0, data[:-1] + bytes([data[-1] ^ 0x01]))]

    def lose_next_byte(self) -> None:
        """Drop the last byte of the next chunk that the device sends."""
        self._next = lambda data: [(0.0, data[:-1])]

    def delay_next(self, delay_s: float) -> None:
        """Delay the next chunk from the device and everything after it."""
        self._next = lambda data: [(delay_s, data)]

    def inject(self, data: bytes) -> None:
        """Send the driver bytes that the device never sent."""
        self._injected.append(data)

    def silence(self, silent: bool = True) -> None:
        """Discard all data from the device until switched off."""
        self._silent = silent

    def cut(self) -> None:
        """Drop the connection; a new one will be accepted."""
        self._cut = True

    def _close(self) -> None:
        self._server.close()

    def _serve(self) -> None:
        self._server.settimeout(POLL_S)
        while not self._ended:
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            self._cut = False
            with client, contextlib.suppress(OSError), contextlib.closing(self._open_device()) as device:
                self._pass_on(client, device)

    def _pass_on(self, client: socket.socket, device: _End) -> None:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ends = selectors.DefaultSelector()
        ends.register(client, selectors.EVENT_READ)
        ends.register(device, selectors.EVENT_READ)
        held: list[tuple[float, bytes]] = []  # (due, bytes), in order of arrival
        with ends:
            while not (self._ended or self._cut):
                wait_s = POLL_S
                if held:
                    wait_s = min(wait_s, max(0.0, held[0][0] - time.monotonic()))
                for key, _ in ends.select(wait_s):
                    try:
                        data = os.read(key.fd, CHUNK_BYTES)
                    except BlockingIOError:  # a terminal that was flushed meanwhile
                        continue
                    if not data:
                        return
                    if key.fileobj is client:
                        self._note_command(data)
                        _write_all(device.fileno(), data)
                    elif not self._silent:
                        held += self._schedule(self._disturb(data), held)
                while self._injected:
                    held += self._schedule([(0.0, self._injected.pop(0))], held)
                while held and held[0][0] <= time.monotonic():
                    client.sendall(held.pop(0)[1])

    def _note_command(self, data: bytes) -> None:
        """Inspect data from the driver, which is passed on unchanged (hook for subclasses)."""

    def _disturb(self, data: bytes) -> list[tuple[float, bytes]]:
        disturbance, self._next = self._next, None
        return disturbance(data) if disturbance else [(0.0, data)]

    @staticmethod
    def _schedule(
        deliveries: list[tuple[float, bytes]], held: list[tuple[float, bytes]]
    ) -> list[tuple[float, bytes]]:
        now_s = time.monotonic()
        earliest_s = held[-1][0] if held else now_s  # nothing overtakes earlier data
        return [(max(earliest_s, now_s + delay_s), part) for delay_s, part in deliveries]

    def _open_device(self) -> _End:
        if self._device.scheme != "serial":
            peer = socket.create_connection((self._device.host, self._device.port), OPEN_TIMEOUT_S)
            peer.settimeout(None)
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return peer
        import serial

        line: _End = serial.Serial(self._device.path, timeout=0, exclusive=True)
        return line


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]
