"""Primary client: reads the controller's states and messages, and sends scripts.

The controller closes this connection when its pendant changes between local and remote control.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from drivers.universal_robots.errors import BAD_BYTES, STREAM_ERRORS
from drivers.universal_robots.primary.packages import (
    HEADER,
    LONGEST_PACKAGE_BYTES,
    Joints,
    KinematicsInfo,
    Masterboard,
    Message,
    RobotModeData,
    iterate_parts,
    read_message,
)
from ronna_hw.arm_stream.control_channel import BytesPassed, ControlChannel
from ronna_hw.vectors import JointVector
from ronna_hw.wire.universal_robots_services import PackageKind

MESSAGES_KEPT = 20
T = TypeVar("T")


@dataclass(frozen=True)
class ControllerState:
    """State of the controller as it was last reported. A package may carry only some of its parts."""

    received_s: float  # host time at which its oldest part was received
    came_after_s: float  # by which none of its parts had arrived
    device_clock: int  # time stamp in the package with the joints, us; 0 without one
    mode: RobotModeData
    joints_rad: JointVector
    moving: bool
    digital_inputs: int
    safety_mode: int


class _Dated(NamedTuple, Generic[T]):
    """Part of a state, with the times of its package."""

    part: T
    received_s: float
    came_after_s: float
    device_clock: int


class PrimaryClient(ControlChannel[ControllerState]):
    """Thread-safe connection to the primary interface."""

    errors = STREAM_ERRORS
    thread_name = "ur primary reader"

    def __init__(self, host: str, port: int, timeout_s: float, on_bytes: BytesPassed | None = None) -> None:
        """Connect; raises URD-002 on failure. `on_bytes` receives all traffic."""
        self._received = b""
        self._mode: _Dated[RobotModeData] | None = None
        self._joints: _Dated[Joints] | None = None
        self._board: _Dated[Masterboard] | None = None
        self.kinematics: KinematicsInfo | None = None
        self.messages: deque[Message] = deque(maxlen=MESSAGES_KEPT)
        super().__init__(host, port, timeout_s, on_bytes)

    def await_kinematics(self, timeout_s: float) -> KinematicsInfo:
        """Return the factory calibration, which comes with the first state; raises URD-015."""
        return self._await(lambda: self.kinematics, "its factory calibration", timeout_s)

    def await_state(self, timeout_s: float) -> ControllerState:
        """Return the last state; raises URD-015 without one, URD-014 on a loss."""
        return self._await(lambda: self.latest, "a state", timeout_s)

    def await_new_state(self, timeout_s: float) -> ControllerState:
        """Return a state that arrives after this call, however late the reader runs; raises as above."""
        asked_s = time.monotonic()
        self._note_emptied()

        def find() -> ControllerState | None:
            latest = self.latest
            return latest if latest is not None and latest.came_after_s >= asked_s else None

        return self._await(find, "a state", timeout_s)

    def send_script(self, script: str) -> None:
        """Send a program, which replaces any that runs; raises URD-014."""
        self._transmit(script.encode("ascii"))

    def _await(self, find: Callable[[], T | None], what: str, timeout_s: float) -> T:
        if (found := self._wait_for(find, timeout_s)) is None:
            raise STREAM_ERRORS.no_answer(f"{self.where} does not send {what}", limit=f"{timeout_s:g} s")
        return found

    def _split(self, data: bytes) -> Iterator[bytes]:
        self._received += data
        while (size := package_size(self._received)) is not None and len(self._received) >= size:
            package, self._received = self._received[:size], self._received[size:]
            yield package

    def _take(self, message: bytes) -> ControllerState | None:
        _, kind = HEADER.unpack_from(message)
        payload = message[HEADER.size :]
        if kind == PackageKind.MESSAGE:
            self.messages.append(read_message(payload))
        return self._take_parts(payload) if kind == PackageKind.ROBOT_STATE else None

    def _take_parts(self, payload: bytes) -> ControllerState | None:
        """Take over the parts of a robot state, and return a state with the last of each kind."""
        parts, received_s = list(iterate_parts(payload)), time.monotonic()
        clock_us = next((part.timestamp_us for part in parts if isinstance(part, RobotModeData)), 0)
        for part in parts:
            match part:
                case RobotModeData():
                    self._mode = _Dated(part, received_s, self._came_after_s, clock_us)
                case Joints():
                    self._joints = _Dated(part, received_s, self._came_after_s, clock_us)
                case Masterboard():
                    self._board = _Dated(part, received_s, self._came_after_s, clock_us)
                case KinematicsInfo():
                    self.kinematics = part
        mode, joints, board = self._mode, self._joints, self._board
        if mode is None or joints is None or board is None:
            return None
        return ControllerState(
            min(mode.received_s, joints.received_s, board.received_s),
            min(mode.came_after_s, joints.came_after_s, board.came_after_s),
            joints.device_clock,
            mode.part,
            joints.part.angles_rad,
            joints.part.moving,
            board.part.digital_inputs,
            board.part.safety_mode,
        )


def package_size(received: bytes) -> int | None:
    """Return the size of the package that begins here; None as long as it is unknown. Raises URD-016."""
    if len(received) < HEADER.size:
        return None
    size: int = HEADER.unpack_from(received)[0]
    if not HEADER.size <= size <= LONGEST_PACKAGE_BYTES:
        raise BAD_BYTES(f"a package of {size} bytes on the primary interface", wire=received)
    return size
