"""Primary client: reads the controller's states and messages in a thread, and sends scripts.

The controller closes this connection when its pendant changes between local and remote control.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from drivers.universal_robots.errors import BadBytes, ControllerLost, ControllerNotFound, NoAnswer
from drivers.universal_robots.primary.packages import (
    HEADER,
    LONGEST_PACKAGE_BYTES,
    Joints,
    KinematicsInfo,
    Masterboard,
    Message,
    PackageKind,
    RobotModeData,
    iterate_parts,
    read_message,
)
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector

RECEIVE_BYTES = 4096
CLOSE_TIMEOUT_S = 1.0
QUIET_S = 0.2  # two periods of the state: after such a silence a listener should check how long it lasts
READER_LIMIT_S = 2.0  # beyond its limit, in which a wait lets the reader take what has arrived by then
MESSAGES_KEPT = 20
T = TypeVar("T")
_TIMEVAL = struct.Struct("ll")


@dataclass(frozen=True)
class ControllerState:
    """State of the controller as it was last reported, with the host time of its arrival."""

    received_s: float
    mode: RobotModeData
    joints_rad: JointVector
    moving: bool
    digital_inputs: int
    safety_mode: int


class Listener(Protocol):
    """Callbacks on the reader thread; they must return quickly."""

    def on_state(self, state: ControllerState) -> None:
        """Handle a state."""
        ...

    def on_silence(self) -> None:
        """Handle another `QUIET_S` without data from the controller."""
        ...

    def on_loss(self, failure: RonnaError) -> None:
        """Handle the loss of the connection; not called when we close it."""
        ...


class PrimaryClient:
    """Thread-safe connection to the primary interface."""

    def __init__(
        self,
        host: str,
        port: int,
        timeout_s: float,
        on_bytes: Callable[[Direction, bytes], None] | None = None,
    ) -> None:
        """Connect; raises URD-002 on failure. `on_bytes` receives all traffic."""
        self.where = f"tcp://{host}:{port}"
        self._on_bytes = on_bytes
        try:
            self._socket = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise ControllerNotFound(f"nothing answers at {self.where} ({reason})") from error
        self._socket.settimeout(None)
        # Applies to receiving only: senders may wait longer.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(0, round(QUIET_S * 1e6)))
        self._arrived = threading.Condition()
        self._sending = threading.Lock()
        self._mode: RobotModeData | None = None
        self._joints: Joints | None = None
        self._board: Masterboard | None = None
        self.latest: ControllerState | None = None
        self.kinematics: KinematicsInfo | None = None
        self.messages: deque[Message] = deque(maxlen=MESSAGES_KEPT)
        self.failure: RonnaError | None = None  # cause of the loss
        self._heard_s = time.monotonic()
        self._listened_s = self._heard_s  # up to here the reader has taken all that arrived
        self._listener: Listener | None = None
        self._closing = False
        self._reader = threading.Thread(target=self._read_packages, name="ur primary reader", daemon=True)
        self._reader.start()

    @property
    def silent_s(self) -> float:
        """Host time for which the reader has listened in vain; not the time in which it did not run."""
        return max(0.0, self._listened_s - self._heard_s)

    def listen(self, listener: Listener) -> None:
        """Register a listener for states, silence and loss of the connection."""
        self._listener = listener
        if self.failure is not None and not self._closing:
            listener.on_loss(self.failure)

    def await_kinematics(self, timeout_s: float) -> KinematicsInfo:
        """Return the factory calibration, which comes with the first state; raises URD-015."""
        return self._await(lambda: self.kinematics, "its factory calibration", timeout_s)

    def await_state(self, timeout_s: float, newer_than_s: float = 0.0) -> ControllerState:
        """Return a state that arrived after a host time; raises URD-015 without one, URD-014 on a loss."""

        def find() -> ControllerState | None:
            latest = self.latest
            return latest if latest is not None and latest.received_s > newer_than_s else None

        return self._await(find, "a state", timeout_s)

    def send_script(self, script: str) -> None:
        """Send a program, which replaces any that runs; raises URD-014."""
        data = script.encode("ascii")
        try:
            with self._sending:
                self._socket.sendall(data)
        except OSError as error:
            raise self.failure or self._lost_error(f": {(error.strerror or str(error)).lower()}") from error
        if self._on_bytes is not None:
            self._on_bytes(Direction.SENT, data)

    def close(self) -> None:
        """Close the connection; never raises."""
        self._closing = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        if self._reader is not threading.current_thread():
            self._reader.join(CLOSE_TIMEOUT_S)

    def _await(self, find: Callable[[], T | None], what: str, timeout_s: float) -> T:
        deadline = time.monotonic() + timeout_s
        with self._arrived:
            while True:
                found = find()
                if found is not None:
                    return found
                if self.failure is not None:
                    raise self.failure
                now_s = time.monotonic()
                # On a busy computer this thread may run first, while the state waits in the socket.
                limit_s = deadline if self._listened_s >= deadline else deadline + READER_LIMIT_S
                if now_s >= limit_s:
                    raise NoAnswer(f"{self.where} does not send {what}", limit=f"{timeout_s:g} s")
                self._arrived.wait((deadline if now_s < deadline else limit_s) - now_s)

    def _read_packages(self) -> None:
        received = b""
        failure: RonnaError
        try:
            while data := self._receive():
                received += data
                while (size := package_size(received)) is not None and len(received) >= size:
                    self._handle(received[:size])
                    received = received[size:]
            failure = self._lost_error(" closed the connection")
        except RonnaError as error:
            failure = error
        except Exception as error:  # also a listener's: without a reader nothing would be noticed
            failure = self._lost_error(
                f": {getattr(error, 'strerror', None) or error or type(error).__name__}"
            )
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
                data = self._socket.recv(RECEIVE_BYTES)
            except BlockingIOError:
                with self._arrived:
                    self._listened_s = began_s + QUIET_S
                    self._arrived.notify_all()
                if self._listener is not None:
                    self._listener.on_silence()
                continue
            self._heard_s = time.monotonic()
            if self._on_bytes is not None:
                self._on_bytes(Direction.RECEIVED, data)
            return data

    def _handle(self, package: bytes) -> None:
        _, kind = HEADER.unpack_from(package)
        payload = package[HEADER.size :]
        state = None
        with self._arrived:
            if kind == PackageKind.MESSAGE:
                self.messages.append(read_message(payload))
            elif kind == PackageKind.ROBOT_STATE:
                state = self._take_parts(payload)
            self._arrived.notify_all()
        if state is not None and self._listener is not None:
            self._listener.on_state(state)

    def _take_parts(self, payload: bytes) -> ControllerState | None:
        """Take over the parts of a robot state; a package may carry only some of them."""
        for part in iterate_parts(payload):
            match part:
                case RobotModeData():
                    self._mode = part
                case Joints():
                    self._joints = part
                case Masterboard():
                    self._board = part
                case KinematicsInfo():
                    self.kinematics = part
        mode, joints, board = self._mode, self._joints, self._board
        if mode is None or joints is None or board is None:
            return None
        self.latest = ControllerState(
            time.monotonic(),
            mode,
            joints.angles_rad,
            joints.moving,
            board.digital_inputs,
            board.safety_mode,
        )
        return self.latest

    def _lost_error(self, how: str) -> ControllerLost:
        return ControllerLost(f"{self.where}{how}")


def package_size(received: bytes) -> int | None:
    """Return the size of the package that begins here; None as long as it is unknown. Raises URD-016."""
    if len(received) < HEADER.size:
        return None
    size: int = HEADER.unpack_from(received)[0]
    if not HEADER.size <= size <= LONGEST_PACKAGE_BYTES:
        raise BadBytes(f"a package of {size} bytes on the primary interface", wire=received)
    return size
