"""The control channel to one camera: commands with retries, acknowledges matched by request id."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from drivers.basler_stereo.control import gvcp
from drivers.basler_stereo.errors import CommandRefused, NoReply
from ronna_hw.devices.capabilities import Direction
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import GvcpCommand

FIRST_TRY_S = 0.2  # a camera replies within milliseconds; each retry waits twice as long
COMMAND_LIMIT_S = 1.5  # for one command including retries, unless the caller's deadline is earlier
REFUSED_PAUSE_S = 0.05  # between tries while the host reports a closed port
OWN_IDS_LAST = gev.REQUEST_ID_LAST - 1  # the last id is reserved for the receiver process, for keep-alives
DATAGRAM_LIMIT_BYTES = 65_536
LAST_LOOK_S = 1e-3  # for a reply that arrived while the host stalled


class ControlChannel:
    """One socket, one command at a time; safe to use from several threads.

    Retries reuse the request id, so that a device that replies late does not execute a command twice.
    """

    def __init__(
        self,
        address: str,
        *,
        port: int = gev.GVCP_PORT,
        monotonic: Callable[[], float] = time.monotonic,
        passed: Callable[[Direction, bytes], None] = lambda _direction, _data: None,
    ) -> None:
        """`passed` is called with every datagram. Raises OSError when there is no route to the address."""
        self._passed = passed
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((address, port))  # datagrams from other addresses are filtered out
        except OSError:
            self._socket.close()
            raise
        self._address = address
        self._monotonic = monotonic
        self._lock = threading.RLock()
        self._id_lock = threading.Lock()
        self._request_id = 0
        self.port_closed = False  # the address is reachable, but nothing listens on its GVCP port

    @property
    def address(self) -> str:
        """Address of the camera."""
        return self._address

    @property
    def peer_address(self) -> str:
        """The camera's address in numbers."""
        return str(self._socket.getpeername()[0])

    @property
    def local_address(self) -> str:
        """The host's own address on the route to the camera."""
        return str(self._socket.getsockname()[0])

    @property
    def link(self) -> socket.socket:
        """For the receiver process, which sends resend requests and keep-alives through it."""
        return self._socket

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def discover(self, deadline_s: float) -> bytes:
        """The bootstrap registers in a device's reply to discovery; raises GEV-007."""
        return self.ask(GvcpCommand.DISCOVERY, b"", deadline_s, "discovery")

    def read_register(self, address: int, deadline_s: float) -> int:
        """Value of one 32-bit register; raises GEV-006, GEV-007, GEV-008."""
        what = f"reading register 0x{address:X}"
        payload = self.ask(GvcpCommand.READREG, gvcp.read_register_command(address), deadline_s, what)
        return gvcp.register_value(payload, what)

    def write_register(self, address: int, value: int, deadline_s: float) -> None:
        """Set one 32-bit register; raises GEV-006, GEV-007."""
        what = f"writing 0x{value:X} to register 0x{address:X}"
        self.ask(GvcpCommand.WRITEREG, gvcp.write_register_command(address, value), deadline_s, what)

    def read_memory(self, address: int, count: int, deadline_s: float) -> bytes:
        """`count` bytes from `address`, in as many requests as needed; raises GEV-006, GEV-007, GEV-008."""
        data = bytearray()
        while len(data) < count:
            start = address + len(data)
            piece = min(gev.READMEM_LIMIT, -(-(count - len(data)) // 4) * 4)
            payload = self.ask(
                GvcpCommand.READMEM,
                gvcp.read_memory_command(start, piece),
                deadline_s,
                f"reading memory at 0x{start:X}",
            )
            data += gvcp.memory_data(payload, start, piece)
        return bytes(data[:count])

    def write_memory(self, address: int, data: bytes, deadline_s: float) -> None:
        """Write a few bytes, a multiple of 4; raises GEV-006, GEV-007."""
        what = f"writing memory at 0x{address:X}"
        self.ask(GvcpCommand.WRITEMEM, gvcp.write_memory_command(address, data), deadline_s, what)

    def ask(self, command: GvcpCommand, payload: bytes, deadline_s: float, what: str) -> bytes:
        """Send a command and return the payload of its acknowledge; raises GEV-006, GEV-007."""
        with self._lock:
            request_id, datagram = self._prepare(command, payload)
            self._send(datagram)
            return self._finish(command, request_id, datagram, deadline_s, what)

    def _prepare(self, command: GvcpCommand, payload: bytes) -> tuple[int, bytes]:
        request_id = self._next_id()
        return request_id, gvcp.encode(command, request_id, payload)

    def _finish(
        self, command: GvcpCommand, request_id: int, datagram: bytes, deadline_s: float, what: str
    ) -> bytes:
        """Wait for the acknowledge of a sent command, with retries."""
        # a deadline that passed while waiting for the lock or the CPU still allows one try
        begun_s = self._monotonic()
        deadline_s = max(deadline_s, begun_s + FIRST_TRY_S)
        limit_s = min(deadline_s, begun_s + COMMAND_LIMIT_S)
        patience_s = FIRST_TRY_S
        while True:
            acknowledge = self._receive(
                command, request_id, min(limit_s, self._monotonic() + patience_s), deadline_s
            )
            if acknowledge is not None:
                return gvcp.require_success(acknowledge, f"{self._address}: {what}")
            if self._monotonic() >= limit_s:
                raise NoReply(f"{self._address}: no reply", expected=what, limit=f"{COMMAND_LIMIT_S} s")
            patience_s *= 2.0
            self._send(datagram)

    def _receive(
        self, command: GvcpCommand, request_id: int, until_s: float, deadline_s: float
    ) -> gvcp.Acknowledge | None:
        """The acknowledge with this request id, or None if it has not arrived by `until_s`."""
        while True:
            # even after the deadline: whatever arrived while the host stalled was in time
            left_s = until_s - self._monotonic()
            if left_s < -COMMAND_LIMIT_S:
                return None  # only unrelated datagrams
            self._socket.settimeout(max(LAST_LOOK_S, left_s))
            try:
                datagram = self._socket.recv(DATAGRAM_LIMIT_BYTES)
            except TimeoutError:
                return None
            except ConnectionRefusedError:  # the host at that address reports a closed port
                self.port_closed = True
                time.sleep(max(0.0, min(REFUSED_PAUSE_S, until_s - self._monotonic())))
                return None
            self._passed(Direction.RECEIVED, datagram)
            acknowledge = gvcp.decode(datagram)
            if acknowledge is None or acknowledge.request_id != request_id:
                continue  # a late acknowledge of an earlier command
            if acknowledge.command == GvcpCommand.PENDING_ACK:
                wait_s = gvcp.pending_ms(acknowledge.payload) / 1000.0
                until_s = min(deadline_s, max(until_s, self._monotonic() + wait_s))
                continue
            if acknowledge.command == command + 1:
                return acknowledge

    def _send(self, datagram: bytes) -> None:
        # an error here (network down, closed port) shows up as a missing acknowledge, which is reported
        with contextlib.suppress(OSError):
            self._socket.send(datagram)
            self._passed(Direction.SENT, datagram)

    def _next_id(self) -> int:
        with self._id_lock:
            self._request_id = self._request_id % OWN_IDS_LAST + gev.REQUEST_ID_FIRST
            return self._request_id


Command = tuple[GvcpCommand, bytes]
"""A command and its payload."""


def register_write(address: int, value: int) -> Command:
    """The command that sets one register."""
    return GvcpCommand.WRITEREG, gvcp.write_register_command(address, value)


def send_together(
    commands: Sequence[tuple[ControlChannel, Command]], deadline_s: float, what: str
) -> list[Exception | None]:
    """Send a command on each of several channels as close together as one host can.

    All commands are sent before the first acknowledge is awaited. Returns None or an error per channel.
    """
    results: list[Exception | None] = []
    with ExitStack() as locks:
        for channel, _ in commands:
            locks.enter_context(channel._lock)
        prepared = [
            (channel, code, *channel._prepare(code, payload)) for channel, (code, payload) in commands
        ]
        for channel, _, _, datagram in prepared:
            channel._send(datagram)
        for channel, code, request_id, datagram in prepared:
            try:
                channel._finish(code, request_id, datagram, deadline_s, what)
                results.append(None)
            except (NoReply, CommandRefused) as error:
                results.append(error)
    return results
