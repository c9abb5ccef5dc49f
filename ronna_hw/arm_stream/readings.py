"""Numbered readings of an arm, from its stream or its control channel."""

from __future__ import annotations

import contextlib
import time
from typing import Any, Generic

from ronna_hw.arm_stream.connections import StreamConnections
from ronna_hw.arm_stream.control_channel import ReportedState, S
from ronna_hw.arm_stream.mailbox import MailboxTorn
from ronna_hw.arm_stream.records import LinkState
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.errors import RonnaError

STALE_S = 0.5  # host time: age at which a measured pose is called stale


class StreamReadings(Generic[S]):
    """Numbered readings from one arm, with the latest kept for observers."""

    def __init__(self, connections: StreamConnections[S, Any], *, senses_force: bool) -> None:
        self._connections = connections
        self._clock = connections.clock
        self._senses_force = senses_force
        self._stale_s = max(STALE_S, connections.faults.options.silence_limit_s)
        self._sequence = 0
        self._newest: ArmReading | None = None

    def stamp(self, device_clock: int = 0) -> Stamp:
        """Return the stamp for a new reading."""
        self._sequence += 1
        return Stamp(self._sequence, device_clock, self._clock.now_s())

    def from_stream(self, state: LinkState) -> ArmReading:
        """Build a reading from the last telegram's joint angles."""
        self._newest = self._make_stream_reading(state, self.stamp(state.device_clock))
        return self._newest

    def from_controller(self, state: S) -> ArmReading:
        """Build a reading from a state that the controller reported."""
        self._newest = _controller_reading(state, self.stamp(state.device_clock))
        return self._newest

    def newest(self, *, streaming: bool) -> tuple[ArmReading | None, bool]:
        """Return the latest reading, requested or unsolicited, and whether the stream has ended by a fault.

        Never raises, in any thread.
        """
        link, stopped = self._connections.open_link, False
        # Another thread may be closing the link or the clock: then the previous reading is the latest.
        with contextlib.suppress(RonnaError, OSError, ValueError, MailboxTorn):
            now_s, host_s = self._clock.now_s(), time.monotonic()
            if streaming and link is not None:
                state = link.state
                stopped = bool(state.fault)
                age_s = host_s - state.received_ns / 1e9
                stamp = Stamp(self._sequence, state.device_clock, now_s - age_s)
                self._newest = self._make_stream_reading(state, stamp)
            elif (reported := self._connections.reported) is not None:
                age_s = host_s - reported.received_s
                stamp = Stamp(self._sequence, reported.device_clock, now_s - age_s)
                self._newest = _controller_reading(reported, stamp)
        return self._newest, stopped

    def _make_stream_reading(self, state: LinkState, stamp: Stamp) -> ArmReading:
        age_s = (time.monotonic_ns() - state.received_ns) / 1e9
        return ArmReading(
            stamp,
            Validity.OK if age_s <= self._stale_s else Validity.STALE,
            state.measured_rad,
            state.commanded_rad,
            state.moving or not state.settled,
            state.force_N if self._senses_force else None,
        )


def _controller_reading(state: ReportedState, stamp: Stamp) -> ArmReading:
    return ArmReading(stamp, Validity.OK, state.joints_rad, commanded_rad=None, moving=state.moving)
