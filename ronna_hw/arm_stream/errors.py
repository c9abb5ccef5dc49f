"""Errors common to all streams, under the codes of each driver."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.errors import (
    AnyCode,
    ConnectError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    StateError,
)


@dataclass(frozen=True)
class StreamErrors:
    """A driver's errors, and its word for the time stamp of telegrams."""

    not_found: AnyCode[ConnectError]  # no controller answers
    lost: AnyCode[ProtocolError]  # a connection to it broke
    no_answer: AnyCode[LinkTimeout]
    not_started: AnyCode[ConnectError]  # the real-time process
    died: AnyCode[DeviceError]
    stalled: AnyCode[DeviceError]
    silent: AnyCode[LinkTimeout]  # no telegram came
    heartbeat_late: AnyCode[LinkTimeout]
    tripped: AnyCode[LimitError]  # by the monitor
    path_failed: AnyCode[LimitError]
    unusable: AnyCode[LinkTimeout]  # too many losses
    protective_stop: AnyCode[StateError]
    link_stopped: AnyCode[StateError]
    drives_off: AnyCode[StateError]
    stopped: AnyCode[MotionInterrupted]
    not_finished: AnyCode[LinkTimeout]
    refused: AnyCode[RefusedError]
    clock_name: str
    message_name: str  # of what the controller sends in every cycle
    speed_name: str = "the controller's speed"  # what slows motions there
    speed_action: str | None = None  # and what to do about it
