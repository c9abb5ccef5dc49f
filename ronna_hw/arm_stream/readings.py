"""Numbered readings of an arm, from its stream or from whatever else its controller reports."""

from __future__ import annotations

import contextlib
import time

from ronna_hw.arm_stream.mailbox import MailboxTorn
from ronna_hw.arm_stream.records import LinkState
from ronna_hw.arm_stream.watch import HasLink
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.errors import RonnaError

STALE_S = 0.5  # host time: age at which a measured pose is called stale


class StreamReadings:
    """Numbered readings from one arm, with the latest kept for observers."""

    senses_force = False

    def __init__(self, connections: HasLink, clock: Clock, silence_limit_s: float) -> None:
        self._link_of = connections
        self._clock = clock
        self._stale_s = max(STALE_S, silence_limit_s)
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

    def newest(self, *, streaming: bool) -> ArmReading | None:
        """Return the latest reading, requested or unsolicited; never raises, in any thread."""
        link = self._link_of.open_link
        # Another thread may be closing the link or the clock: then the previous reading is the latest.
        with contextlib.suppress(RonnaError, OSError, ValueError, MailboxTorn):
            now_s, host_s = self._clock.now_s(), time.monotonic()
            if streaming and link is not None:
                state = link.state
                age_s = host_s - state.received_ns / 1e9
                stamp = Stamp(self._sequence, state.device_clock, now_s - age_s)
                self._newest = self._make_stream_reading(state, stamp)
            else:
                self._newest = self._reported_reading(now_s, host_s) or self._newest
        return self._newest

    def _reported_reading(self, now_s: float, host_s: float) -> ArmReading | None:
        """Build a reading from the controller's last report without a stream, if there is one."""
        return None

    def _make_stream_reading(self, state: LinkState, stamp: Stamp) -> ArmReading:
        age_s = (time.monotonic_ns() - state.received_ns) / 1e9
        return ArmReading(
            stamp,
            Validity.OK if age_s <= self._stale_s else Validity.STALE,
            state.measured_rad,
            state.commanded_rad,
            state.moving or not state.settled,
            state.force_N if self.senses_force else None,
        )
