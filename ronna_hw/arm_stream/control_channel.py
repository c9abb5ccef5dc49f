"""Control channel: the connection on which a controller reports its state and takes commands.

A thread reads everything that the controller sends: some close the connection otherwise, and an emergency
stop must be noticed although nobody asks.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from ronna_hw.arm_stream.errors import ControllerLost, StreamErrors
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import AnyCode, ConnectError, RonnaError
from ronna_hw.vectors import JointVector

RECEIVE_BYTES = 4096
CLOSE_TIMEOUT_S = 1.0
QUIET_S = 0.2  # two periods of the state: after such a silence a listener should check how long it lasts
READER_LIMIT_S = 2.0  # beyond its limit, in which a wait lets the reader take what has arrived by then
_TIMEVAL = struct.Struct("ll")

T = TypeVar("T")
BytesPassed = Callable[[Direction, bytes], None]


class ReportedState(Protocol):
    """State of a controller as it reported it."""

    @property
    def received_s(self) -> float:
        """Host time of its arrival."""

    @property
    def device_clock(self) -> int:
        """Time stamp by the controller, 0 without one."""

    @property
    def joints_rad(self) -> JointVector:
        """Measured joint angles."""

    @property
    def moving(self) -> bool:
        """Whether the arm moves."""


S = TypeVar("S", bound=ReportedState)
S_contra = TypeVar("S_contra", bound=ReportedState, contravariant=True)


class Listener(Protocol[S_contra]):
    """Callbacks on the reader thread; they must return quickly."""

    def on_state(self, state: S_contra) -> None:
        """Handle a state."""

    def on_silence(self) -> None:
        """Handle another `QUIET_S` without data from the controller."""

    def on_loss(self, failure: RonnaError) -> None:
        """Handle the loss of the connection; not called when we close it."""


class ControlChannel(ABC, Generic[S]):
    """Thread-safe control channel; a driver splits and decodes what it carries, and adds its commands."""

    errors: ClassVar[StreamErrors]
    thread_name: ClassVar[str]

    def __init__(self, host: str, port: int, timeout_s: float, on_bytes: BytesPassed | None = None) -> None:
        """Connect; raises `errors.not_found`. `on_bytes` receives all traffic.

        The reader starts here: what a driver needs for it must exist before.
        """
        self._on_bytes = on_bytes
        self.where = f"tcp://{host}:{port}"
        self._socket = open_connection(host, port, timeout_s, self.errors.not_found)
        self._socket.settimeout(None)
        # Applies to receiving only: senders may wait longer.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(0, round(QUIET_S * 1e6)))
        self._arrived = threading.Condition()
        self._sending = threading.Lock()
        self.latest: S | None = None  # the last state, requested or unsolicited
        self.failure: RonnaError | None = None  # cause of the loss
        self._opened_s = time.monotonic()
        self._listened_s = self._opened_s  # up to then the reader has taken all that arrived
        self._receiving = threading.Lock()
        self._emptied_s = self._opened_s  # when nothing was unread: what is received next came later
        self._came_after_s = self._opened_s  # the bytes in the reader's hands
        self._listener: Listener[S] | None = None
        self._closing = False
        self._reader = threading.Thread(target=self._read, name=self.thread_name, daemon=True)
        self._reader.start()

    @abstractmethod
    def _split(self, data: bytes) -> Iterator[bytes]:
        """Yield the messages that are complete with these bytes; raises the driver's errors."""

    @abstractmethod
    def _take(self, message: bytes) -> S | None:
        """Take over a message, and return the state if it carries one; called with the lock held."""

    @property
    def silent_s(self) -> float:
        """Host time for which the reader has listened in vain for a state.

        The time in which this program did not run is no silence of the controller.
        """
        latest = self.latest
        return max(0.0, self._listened_s - (self._opened_s if latest is None else latest.received_s))

    def listen(self, listener: Listener[S]) -> None:
        """Register a listener for states, silence and loss of the connection."""
        self._listener = listener
        if self.failure is not None and not self._closing:
            listener.on_loss(self.failure)

    def close(self) -> None:
        """Close the connection; never raises."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._reader is not threading.current_thread():
            self._reader.join(CLOSE_TIMEOUT_S)

    def _transmit(self, data: bytes) -> None:
        """Send bytes; raises the cause of a loss."""
        try:
            with self._sending:
                self._socket.sendall(data)
                if self._on_bytes is not None:
                    self._on_bytes(Direction.SENT, data)
        except OSError as error:
            raise self.failure or self._lost_error(f": {describe(error)}") from error

    def _wait_for(self, find: Callable[[], T | None], timeout_s: float) -> T | None:
        """Wait until something has arrived; returns None on time-out, raises the cause of a loss."""
        deadline = time.monotonic() + timeout_s
        with self._arrived:
            while True:
                if (found := find()) is not None:
                    return found
                if self.failure is not None:
                    raise self.failure
                now_s = time.monotonic()
                # On a busy computer this thread may run first, while the answer waits in the socket.
                limit_s = deadline if self._listened_s >= deadline else deadline + READER_LIMIT_S
                if now_s >= limit_s:
                    return None
                self._arrived.wait((deadline if now_s < deadline else limit_s) - now_s)

    def _note_emptied(self) -> None:
        """If nothing is unread, note that what is received next has arrived later than now."""
        with self._receiving, contextlib.suppress(OSError):
            now_s = time.monotonic()
            try:
                self._socket.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
            except BlockingIOError:
                self._emptied_s = now_s

    def _lost_error(self, how: str) -> ControllerLost:
        return self.errors.lost(f"{self.where}{how}")

    def _read(self) -> None:
        failure: RonnaError
        try:
            while data := self._receive():
                received_s = time.monotonic()
                for message in self._split(data):
                    self._handle(message)
                if len(data) < RECEIVE_BYTES:  # nothing was left in the socket
                    self._tell_listened(received_s)
            failure = self._lost_error(" closed the connection")
        except RonnaError as error:
            failure = error
        except Exception as error:  # also a listener's: without a reader no emergency stop would arrive
            failure = self._lost_error(f": {describe(error)}")
        with self._arrived:
            self.failure = failure
            self._arrived.notify_all()
        if self._listener is not None and not self._closing:
            self._listener.on_loss(failure)

    def _receive(self) -> bytes:
        """Receive the next bytes, or none once the controller has closed the connection."""
        while True:
            began_s = time.monotonic()
            try:
                self._socket.recv(1, socket.MSG_PEEK)
                with self._receiving:
                    now_s = time.monotonic()
                    data = self._socket.recv(RECEIVE_BYTES)
                    self._came_after_s = self._emptied_s
                    if len(data) < RECEIVE_BYTES:
                        self._emptied_s = now_s
            except BlockingIOError:
                self._tell_listened(began_s + QUIET_S)
                if self._listener is not None:
                    self._listener.on_silence()
                continue
            if self._on_bytes is not None:
                self._on_bytes(Direction.RECEIVED, data)
            return data

    def _tell_listened(self, until_s: float) -> None:
        with self._arrived:
            self._listened_s = until_s
            self._arrived.notify_all()

    def _handle(self, message: bytes) -> None:
        with self._arrived:
            if (state := self._take(message)) is not None:
                self.latest = state
            self._arrived.notify_all()
        if state is not None and self._listener is not None:
            self._listener.on_state(state)


AnyChannel = ControlChannel[Any]


def open_connection(
    host: str, port: int, timeout_s: float, not_found: AnyCode[ConnectError]
) -> socket.socket:
    """Connect, with a time limit that remains set; raises `not_found`."""
    try:
        connection = socket.create_connection((host, port), timeout_s)
    except OSError as error:
        waited = f"{round(timeout_s, 1):g} s" if isinstance(error, TimeoutError) else ""
        what = f"nothing answers at tcp://{host}:{port} ({describe(error)})"
        raise not_found(what, limit=waited) from error
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def describe(error: Exception) -> str:
    """Say what went wrong, in the system's words if it is one of its errors."""
    return str(getattr(error, "strerror", None) or error or type(error).__name__).lower()
