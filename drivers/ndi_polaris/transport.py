"""Byte transport to the unit over a serial line, pseudo-terminal or TCP, with optional recording."""

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
from ronna_hw.devices.capabilities import ByteSink, Direction
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import find_serial_port_users
from ronna_hw.wire.polaris import DEFAULT_BAUD

WRITE_LIMIT_S = 1.0  # a line that does not accept data for this long is dead
BREAK_MS = 500  # as long as other clients use
READ_BYTES = 65536
CLOSED = -1  # no file has this descriptor
_LISTED = "`ronna-procedure doctor --all` lists the ports of this computer."
_AT_THE_ADDRESS = "check address and port, and that the unit is on and in the same network."
_ADVICE = {
    errno.ENOENT: f"Check the name of the port; {_LISTED}",
    errno.ENOTTY: f"Not a serial port; {_LISTED}",
    errno.EISDIR: f"Not a serial port; {_LISTED}",
    errno.EACCES: "Join the group that owns the port (often `dialout`), then log in again.",
    errno.EAGAIN: "Another program holds the port: stop it, then try again.",
    errno.EBUSY: "Another program holds the port: stop it, then try again.",
    errno.ECONNREFUSED: f"Nothing listens there: {_AT_THE_ADDRESS}",
    errno.ETIMEDOUT: f"No reply from there: {_AT_THE_ADDRESS}",
    errno.EHOSTUNREACH: f"No reply from there: {_AT_THE_ADDRESS}",
    errno.ENETUNREACH: f"No reply from there: {_AT_THE_ADDRESS}",
}
_REASONS = {errno.EAGAIN: "held by another program", errno.ENOTTY: "not a serial port"}


class Transport(Protocol):
    """Bidirectional byte stream; `baud` is None if it does not apply."""

    @property
    def baud(self) -> int | None: ...

    def write(self, data: bytes) -> None:
        """Send all bytes; raises NDI-008 if the connection is lost."""

    def read(self, timeout_s: float) -> bytes:
        """Return received bytes, waiting up to `timeout_s` for the first; empty on time-out.

        Raises NDI-008 when the peer is gone.
        """

    def set_baud(self, baud: int) -> None:
        """Switch the host's port to another baud rate."""

    def send_break(self) -> None:
        """Send a break, which resets the unit, if the transport supports it."""

    def close(self) -> None:
        """Close the transport; never raises."""


def open_transport(endpoint: Endpoint, timeout_s: float) -> Transport:
    """Open a serial:// or tcp:// endpoint; raises NDI-001 on failure, CFG-002 for other schemes."""
    endpoint.require("serial", "tcp")
    if endpoint.scheme == "serial":
        return SerialTransport(endpoint)
    return TcpTransport(endpoint, timeout_s)


class _Descriptor:
    """File descriptor with read and write time limits."""

    def __init__(self, endpoint: Endpoint, descriptor: int) -> None:
        self._endpoint = endpoint
        self._descriptor = descriptor
        self._readable = select.poll()
        self._readable.register(descriptor, select.POLLIN)  # poll reports hang-up and error by default

    def write(self, data: bytes) -> None:
        try:
            sent = os.write(self._descriptor, data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise self._lost_error(error) from error
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
            raise self._lost_error(error) from error
        if not data:
            raise LinkLost(f"{self._endpoint} was closed at the other end")
        return data

    def _write_slowly(self, data: bytes) -> None:
        """Send bytes that did not fit the buffer; raises NDI-008 if the peer does not accept them."""
        writable = select.poll()
        writable.register(self._descriptor, select.POLLOUT)
        until_s = time.monotonic() + WRITE_LIMIT_S
        while data:
            if (remaining_s := until_s - time.monotonic()) <= 0 or not writable.poll(remaining_s * 1000):
                raise LinkLost(f"{self._endpoint} does not accept data", limit=f"{WRITE_LIMIT_S} s")
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._lost_error(error) from error

    def _forget(self) -> None:
        """Forget a closed descriptor, because its number may be reused."""
        self._descriptor = CLOSED

    def _lost_error(self, error: OSError) -> LinkLost:
        return LinkLost(f"{self._endpoint} broke: {_error_reason(error)}")


class SerialTransport(_Descriptor):
    """Serial port, 8N1 without flow control, opened exclusively."""

    def __init__(self, endpoint: Endpoint) -> None:
        try:
            self._port = serial.Serial(endpoint.path, DEFAULT_BAUD, timeout=0, exclusive=True)
        except (OSError, ValueError) as error:
            raise _unavailable_error(endpoint, error) from error
        super().__init__(endpoint, self._port.fileno())
        # A USB adapter holds back the end of a reply for 16 ms, a whole frame, unless set to low latency.
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            self._port.set_low_latency_mode(True)

    @property
    def baud(self) -> int | None:
        return int(self._port.baudrate)

    def set_baud(self, baud: int) -> None:
        try:
            self._port.baudrate = baud
        except (OSError, ValueError, termios.error) as error:
            raise PortUnavailable(
                f"{self._endpoint} does not support {baud} baud: {_error_reason(error)}"
            ) from error

    def send_break(self) -> None:
        try:
            # Anything still buffered dates from before the break.
            termios.tcflush(self._descriptor, termios.TCIOFLUSH)
            termios.tcsendbreak(self._descriptor, BREAK_MS)
        except (OSError, termios.error) as error:
            raise LinkLost(f"cannot send a break on {self._endpoint}: {_error_reason(error)}") from error

    def close(self) -> None:
        if self._descriptor == CLOSED:
            return
        with contextlib.suppress(OSError, termios.error):
            # Closing waits for unsent bytes, which a dead peer never accepts.
            termios.tcflush(self._descriptor, termios.TCOFLUSH)
        with contextlib.suppress(OSError, termios.error):
            self._port.close()
        self._forget()


class TcpTransport(_Descriptor):
    """TCP stream with TCP_NODELAY."""

    def __init__(self, endpoint: Endpoint, timeout_s: float) -> None:
        try:
            self._socket = socket.create_connection((endpoint.host, endpoint.port), timeout_s)
        except OSError as error:
            raise _unavailable_error(endpoint, error) from error
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


def _unavailable_error(endpoint: Endpoint, error: Exception) -> PortUnavailable:
    """Build the error for a line that cannot be opened, with advice for the cause."""
    number, reason = _error_number(error), _error_reason(error)
    users = find_serial_port_users(endpoint.path) if number in (errno.EAGAIN, errno.EBUSY) else ()
    holder_text = f", {' and '.join(map(str, users))}" if users else ""
    unavailable = PortUnavailable(
        f"cannot open {endpoint}: {reason}{holder_text}", action=_ADVICE.get(number or 0)
    )
    unavailable.number, unavailable.reason = number, reason
    return unavailable


def _error_number(error: Exception) -> int | None:
    """Return the errno of an exception, or of its cause as pyserial reports a file that is not a port."""
    if isinstance(error, TimeoutError):
        return errno.ETIMEDOUT
    for candidate in (getattr(error, "errno", None), *getattr(error.__context__, "args", ())[:1]):
        if isinstance(candidate, int) and candidate > 0:
            return candidate
    return None


def _error_reason(error: Exception) -> str:
    if (number := _error_number(error)) is None:
        return str(getattr(error, "strerror", None) or error)
    return _REASONS.get(number) or os.strerror(number).lower()


class RecordedTransport:
    """Transport wrapper that records all traffic."""

    def __init__(self, transport: Transport, link: str, sink: ByteSink) -> None:
        self._transport = transport
        self._link = link
        self._sink = sink

    @property
    def baud(self) -> int | None:
        return self._transport.baud

    def write(self, data: bytes) -> None:
        self._transport.write(data)
        self._sink.on_bytes(self._link, Direction.SENT, data)

    def read(self, timeout_s: float) -> bytes:
        if data := self._transport.read(timeout_s):
            self._sink.on_bytes(self._link, Direction.RECEIVED, data)
        return data

    def set_baud(self, baud: int) -> None:
        self._transport.set_baud(baud)
        if self.baud is not None:
            self._sink.note(self._link, baud=baud)

    def send_break(self) -> None:
        self._transport.send_break()
        self._sink.note(self._link, sent="break")

    def close(self) -> None:
        self._transport.close()
