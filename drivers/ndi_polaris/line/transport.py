"""Bytes to and from the unit: a serial line (or pseudo-terminal) and TCP, behind one small interface."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import termios
import time
from typing import Protocol

import serial

from drivers.ndi_polaris.errors import LinkLost, PortUnavailable
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.polaris import DEFAULT_BAUD

WRITE_LIMIT_S = 1.0  # a line that takes no bytes for this long is dead
BREAK_MS = 500  # as long as other clients of the vendor's units hold it
READ_BYTES = 65536
CLOSED = -1  # no file has this number

_LISTED = "`ronna-procedure doctor` lists the ports of this computer."
_AT_THE_ADDRESS = "check address and port, and that the unit is on and in the same network."
_ADVICE = {
    errno.ENOENT: f"Check the name of the port; {_LISTED}",
    errno.ENOTTY: f"That is no serial port; {_LISTED}",
    errno.EISDIR: f"That is no serial port; {_LISTED}",
    errno.EACCES: "Join the group that owns the port (often `dialout`), then log in again.",
    errno.EAGAIN: "Another program holds the port: end it, then try again.",
    errno.EBUSY: "Another program holds the port: end it, then try again.",
    errno.ECONNREFUSED: f"Nothing listens there: {_AT_THE_ADDRESS}",
    errno.ETIMEDOUT: f"Nothing answers there: {_AT_THE_ADDRESS}",
    errno.EHOSTUNREACH: f"Nothing answers there: {_AT_THE_ADDRESS}",
    errno.ENETUNREACH: f"Nothing answers there: {_AT_THE_ADDRESS}",
}
_REASONS = {errno.EAGAIN: "held by another program", errno.ENOTTY: "not a serial port"}


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


class _Descriptor:
    """Reads and writes of an open file that never block longer than they are told to."""

    def __init__(self, endpoint: Endpoint, descriptor: int) -> None:
        self._endpoint = endpoint
        self._descriptor = descriptor
        self._readable = select.poll()
        self._readable.register(descriptor, select.POLLIN)  # hang-up and error are reported unasked

    def write(self, data: bytes) -> None:
        try:
            sent = os.write(self._descriptor, data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise self._lost(error) from error
        if sent < len(data):
            self._write_slowly(data[sent:])

    def read(self, timeout_s: float) -> bytes:
        if not self._readable.poll(timeout_s * 1000):
            return b""
        try:
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise LinkLost(f"{self._endpoint} was closed at the other end")
        return data

    def _write_slowly(self, data: bytes) -> None:
        """Send what did not fit into the buffers; raises NDI-008 when nobody takes it."""
        writable = select.poll()
        writable.register(self._descriptor, select.POLLOUT)
        until_s = time.monotonic() + WRITE_LIMIT_S
        while data:
            left_s = until_s - time.monotonic()
            if left_s <= 0 or not writable.poll(left_s * 1000):
                raise LinkLost(f"{self._endpoint} takes no bytes", limit=f"{WRITE_LIMIT_S} s")
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._lost(error) from error

    def _forget(self) -> None:
        """After closing, no read or write may reach a file that was given the same number."""
        self._descriptor = CLOSED

    def _lost(self, error: OSError) -> LinkLost:
        return LinkLost(f"{self._endpoint} broke: {_reason(error)}")


class SerialTransport(_Descriptor):
    """8 data bits, no parity, one stop bit, no handshake; held for us alone."""

    def __init__(self, endpoint: Endpoint) -> None:
        try:
            self._port = serial.Serial(endpoint.path, DEFAULT_BAUD, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise _unavailable(endpoint, error) from error
        super().__init__(endpoint, self._port.fileno())
        # A USB adapter holds the end of a reply back for 16 ms, a whole frame, unless it is told not to.
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._port.set_low_latency_mode(True)

    @property
    def baud(self) -> int | None:
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error) as error:
            raise PortUnavailable(f"{self._endpoint} cannot do {baud} baud: {_reason(error)}") from error

    def send_break(self) -> None:
        try:
            # Whatever either side still holds belongs to the time before the break.
            termios.tcflush(self._descriptor, termios.TCIOFLUSH)
            termios.tcsendbreak(self._descriptor, BREAK_MS)
        except (OSError, termios.error) as error:
            raise LinkLost(f"cannot send a break on {self._endpoint}: {_reason(error)}") from error

    def close(self) -> None:
        if self._descriptor == CLOSED:
            return
        with contextlib.suppress(OSError, termios.error):
            # A closing port waits for what it could not send; a dead peer takes nothing.
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        with contextlib.suppress(OSError, termios.error):
            self._port.close()
        self._forget()


class TcpTransport(_Descriptor):
    """A TCP stream without delay of small packets."""

    def __init__(self, endpoint: Endpoint, timeout_s: float) -> None:
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except OSError as error:
            raise _unavailable(endpoint, error) from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        super().__init__(endpoint, self._socket.fileno())

    @property
    def baud(self) -> int | None:
        return None

    def set_baud(self, baud: int) -> None:
        return

    def send_break(self) -> None:
        return

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()
        self._forget()


def _unavailable(endpoint: Endpoint, error: Exception) -> PortUnavailable:
    """The error with the advice that fits its cause."""
    number, reason = _number(error), _reason(error)
    unavailable = PortUnavailable(f"cannot open {endpoint}: {reason}", action=_ADVICE.get(number or 0))
    unavailable.number, unavailable.reason = number, reason
    return unavailable


def _number(error: Exception) -> int | None:
    """The system's number of an error; pyserial hides that of a port that is none in the cause."""
    if isinstance(error, TimeoutError):
        return errno.ETIMEDOUT
    for candidate in (getattr(error, "errno", None), *getattr(error.__context__, "args", ())[:1]):
        if isinstance(candidate, int) and candidate > 0:
            return candidate
    return None


def _reason(error: Exception) -> str:
    number = _number(error)
    if number is None:
        return str(getattr(error, "strerror", None) or error)
    return _REASONS.get(number) or os.strerror(number).lower()
