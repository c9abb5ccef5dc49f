"""Errors common to all streams, under the codes of each driver."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.errors import (
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

    not_found: type[ConnectError]  # no controller answers
    lost: type[ProtocolError]  # a connection to it broke
    no_answer: type[LinkTimeout]
    not_started: type[ConnectError]  # the real-time process
    died: type[DeviceError]
    stalled: type[DeviceError]
    silent: type[LinkTimeout]  # no telegram came
    heartbeat_late: type[LinkTimeout]
    tripped: type[LimitError]  # by the monitor
    path_failed: type[LimitError]
    unusable: type[LinkTimeout]  # too many losses
    protective_stop: type[StateError]
    link_stopped: type[StateError]
    drives_off: type[StateError]
    stopped: type[MotionInterrupted]
    not_finished: type[LinkTimeout]
    refused: type[RefusedError]
    clock_name: str
    message_name: str  # of what the controller sends in every cycle
    speed_name: str = "the controller's speed"  # what slows motions there
    speed_action: str | None = None  # and what to do about it
