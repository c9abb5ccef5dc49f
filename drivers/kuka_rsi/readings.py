"""Readings of the arm: from the stream while it runs, otherwise from the controller's EKI state."""

from __future__ import annotations

import contextlib
import time

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.controller_state import ControllerState
from drivers.kuka_rsi.realtime.link_state import LinkState
from drivers.kuka_rsi.realtime.mailbox import MailboxTorn
from ronna_hw.arm.pose import radians6
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import ArmReading, Stamp, Validity
from ronna_hw.errors import RonnaError

STALE_S = 0.5  # host time: age at which a measured pose is called stale


class ArmReadings:
    """Numbers the readings of one arm, and keeps the latest for observers."""

    def __init__(self, connections: Connections, clock: Clock, silence_limit_s: float) -> None:
        self._connections = connections
        self._clock = clock
        self._stale_s = max(STALE_S, silence_limit_s)
        self._sequence = 0
        self._newest: ArmReading | None = None

    def stamp(self, device_clock: int = 0) -> Stamp:
        """The stamp of the next reading."""
        self._sequence += 1
        return Stamp(self._sequence, device_clock, self._clock.now_s())

    def of_stream(self, state: LinkState) -> ArmReading:
        """Axes of the last telegram."""
        self._newest = self._streamed(state, self.stamp(state.IPOC))
        return self._newest

    def of_controller(self, state: ControllerState) -> ArmReading:
        """Axes of a requested `State`."""
        self._newest = self._reported(state, self.stamp())
        return self._newest

    def newest(self, *, streaming: bool) -> ArmReading | None:
        """The latest, requested or unsolicited; never raises, in any thread."""
        eki, link = self._connections.open_eki, self._connections.open_link
        # Another thread may be closing the link or the clock: then the previous reading is the latest.
        with contextlib.suppress(RonnaError, OSError, ValueError, MailboxTorn):
            now_s, host_s = self._clock.now_s(), time.monotonic()
            if streaming and link is not None:
                state = link.state
                age_s = host_s - state.received_ns / 1e9
                self._newest = self._streamed(state, Stamp(self._sequence, state.IPOC, now_s - age_s))
            elif eki is not None and eki.latest is not None:
                age_s = host_s - eki.latest.received_s
                self._newest = self._reported(eki.latest, Stamp(self._sequence, 0, now_s - age_s))
        return self._newest

    def _streamed(self, state: LinkState, stamp: Stamp) -> ArmReading:
        age_s = (time.monotonic_ns() - state.received_ns) / 1e9
        return ArmReading(
            stamp,
            Validity.OK if age_s <= self._stale_s else Validity.STALE,
            state.measured_rad,
            state.commanded_rad,
            state.moving or not state.settled,
        )

    def _reported(self, state: ControllerState, stamp: Stamp) -> ArmReading:
        return ArmReading(
            stamp, Validity.OK, radians6(*state.axes_deg), commanded_rad=None, moving=state.moving
        )
