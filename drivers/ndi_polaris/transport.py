"""Bytes to and from the unit: a serial line (or pseudo-terminal) and TCP, behind one small interface."""

from __future__ import annotations

import os
import select
import socket
import termios
from typing import Protocol

import serial

from drivers.ndi_polaris.errors import LinkLost, PortUnavailable
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.polaris import DEFAULT_BAUD

WRITE_LIMIT_S = 1.0  # a line that takes no bytes for this long is dead
BREAK_S = 0.5  # as long as other clients of the vendor's units hold it
READ_BYTES = 65536


class Transport(Protocol):
    """A byte stream in both directions. `baud` is None where a rate has no meaning."""

    @property
    def baud(self) -> int | None: ...

    def write(self, data: bytes) -> None:
        """Send everything; raises NDI-008 when the peer is gone."""
        ...

    def read(self, timeout_s: float) -> bytes:
        """Whatever has arrived, waiting at most `timeout_s` for the first byte; empty when nothing came.

        Raises NDI-008 when the peer is gone.
        """
        ...

    def set_baud(self, baud: int) -> None:
        """Switch our end of the line to another rate."""
        ...

    def send_break(self) -> None:
        """Hold the line low: the unit resets itself. Does nothing where a break has no meaning."""
        ...

    def close(self) -> None:
        """Let go of the line; never raises."""
        ...


def open_transport(endpoint: Endpoint, timeout_s: float) -> Transport:
    """Open a serial:// or tcp:// endpoint; raises NDI-001 when it cannot be opened, CFG-002 for others."""
    endpoint.require("serial", "tcp")
    if endpoint.scheme == "serial":
        return SerialTransport(endpoint)
    return TcpTransport(endpoint, timeout_s)


class SerialTransport:
    """8 data bits, no parity, one stop bit, no handshake; held for us alone."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        try:
            self._port = serial.Serial(
                endpoint.path, DEFAULT_BAUD, timeout=0, write_timeout=WRITE_LIMIT_S, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise PortUnavailable(f"cannot open {endpoint}: {_reason(error)}") from error
        self._poll = _readable(self._port.fileno())

    @property
    def baud(self) -> int | None:
        return int(self._port.baudrate)

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except OSError as error:
            raise LinkLost(f"cannot send on {self._endpoint}: {_reason(error)}") from error

    def read(self, timeout_s: float) -> bytes:
        if not self._poll.poll(timeout_s * 1000):
            return b""
        try:
            data = os.read(self._port.fileno(), READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkLost(f"{self._endpoint} closed: {_reason(error)}") from error
        if not data:
            raise LinkLost(f"{self._endpoint} closed")
        return data

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error) as error:
            raise PortUnavailable(f"{self._endpoint} cannot do {baud} baud: {_reason(error)}") from error

    def send_break(self) -> None:
        try:
            # Whatever either side still holds belongs to the time before the break.
            termios.tcflush(self._port.fileno(), termios.TCIOFLUSH)
            self._port.send_break(BREAK_S)
        except (OSError, termios.error) as error:
            raise LinkLost(f"cannot send a break on {self._endpoint}: {_reason(error)}") from error

    def close(self) -> None:
        try:
            self._port.close()
        except (OSError, termios.error):
            return


class TcpTransport:
    """A TCP stream without delay of small packets."""

    def __init__(self, endpoint: Endpoint, timeout_s: float) -> None:
        self._endpoint = endpoint
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except OSError as error:
            raise PortUnavailable(f"cannot connect to {endpoint}: {_reason(error)}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(WRITE_LIMIT_S)
        self._poll = _readable(self._socket.fileno())

    @property
    def baud(self) -> int | None:
        return None

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkLost(f"cannot send to {self._endpoint}: {_reason(error)}") from error

    def read(self, timeout_s: float) -> bytes:
        if not self._poll.poll(timeout_s * 1000):
            return b""
        try:
            data = self._socket.recv(READ_BYTES)
        except OSError as error:
            raise LinkLost(f"{self._endpoint} closed: {_reason(error)}") from error
        if not data:
            raise LinkLost(f"{self._endpoint} closed the connection")
        return data

    def set_baud(self, baud: int) -> None:
        return

    def send_break(self) -> None:
        return

    def close(self) -> None:
        try:
            self._socket.close()
        except OSError:
            return


def _readable(descriptor: int) -> select.poll:
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)  # hang-up and error are reported without asking
    return poll


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    return os.strerror(number).lower() if isinstance(number, int) else str(error)
