"""Reports those events of a camera that have notification switched on."""

from __future__ import annotations

import struct
from collections.abc import Callable

from sim.basler.camera.settings import Settings
from sim.basler.camera.timing import Ticks
from sim.basler.message.channel import MessageChannel
from sim.basler.message.events import FRAME_NUMBER, Event, EventKind

"""What happened, block id (0 without a frame), theatre time in ns."""


class EventReporter:
    """Reports to the message channel of one camera. May be called from any thread."""

    def __init__(self, settings: Callable[[], Settings], channel: MessageChannel, ticks: Ticks) -> None:
        self._settings = settings
        self._channel = channel
        self._ticks = ticks
        self._overrun_reported = False

    def report(self, kind: EventKind, block_id: int, moment_ns: int) -> None:
        """Called when something happened; reported if its notification is on."""
        if kind not in self._settings().events_notified or self._channel.receiver is None:
            return
        data = struct.pack(FRAME_NUMBER, block_id) if kind is EventKind.EXPOSURE_END else b""
        ticks = self._ticks.count(moment_ns)
        if self._channel.tell(Event(kind, block_id, ticks, data)):
            self._overrun_reported = False
        elif EventKind.EVENT_OVERRUN in self._settings().events_notified and not self._overrun_reported:
            # one warning while the queue stays full; the number of lost events is not reported
            self._overrun_reported = True
            self._channel.tell(Event(EventKind.EVENT_OVERRUN, 0, ticks), beyond_limit=True)
