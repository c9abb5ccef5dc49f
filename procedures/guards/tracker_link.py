"""The tracker replies in time: a frame that arrives late shows a head, or a hand, as it was before."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from statistics import median

from procedures.engine.context import CaseMemory
from procedures.guards.room_watch import RoomWatch
from procedures.workcell.device_views import TrackerView
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.tracker import TimedTracker
from ronna_hw.errors import RonnaError

# From request to reply without the transfer, so a slow serial line is not late: at 9600 baud a frame of 170
# bytes takes 0.18 s. A tracker replies within 0.02 s, and a computer stalls for tens of milliseconds. The
# patient watch averages eight readings: with this delay it notices a shift within a second.
LATE_S = 0.1
JUDGED = 5  # replies, by their median: two may be late, such as the first and one while the computer stalls
BETWEEN_LOOKS_S = 10.0  # theatre time, while they are late: a look then takes three replies


def late_s(tracker: TrackerView) -> float | None:
    """How long replies take if that is too long; None also of a tracker that does not report it."""
    if not isinstance(tracker, TimedTracker):
        return None
    last_s = tracker.replies_s[-JUDGED:]
    usual_s = median(last_s) if len(last_s) == JUDGED else 0.0
    return usual_s if usual_s > LATE_S else None


class TrackerLink:
    """Asked at checkpoints. Judges the replies to whoever has read, and looks itself while they are late."""

    name = "tracker link"

    def __init__(self, tracker: TrackerView, memory: CaseMemory, now_s: Callable[[], float]) -> None:
        """`now_s` is the theatre's time."""
        self._tracker = tracker
        self._memory = memory
        self._now_s = now_s
        self._looked_s = -math.inf

    def unmet(self) -> str | None:
        """How late the replies are, while a step reads or a guide approaches the head or is held there."""
        if not self._in_use or late_s(self._tracker) is None:
            return None
        if self._now_s() - self._looked_s >= BETWEEN_LOOKS_S:
            with contextlib.suppress(RonnaError):  # a lost reply; what lasts is latched by the tracker
                self._look()
            self._looked_s = self._now_s()
        late = late_s(self._tracker)
        if late is None:
            return None
        return (
            f"the tracker replies after {late:.2f} s, limit {LATE_S:g} s, and a head that moves would be "
            "noticed late: check its cable and adapter, close other programs on this computer"
        )

    @property
    def _in_use(self) -> bool:
        """Nothing holds up the way out."""
        if self._tracker.state is Lifecycle.CONFIGURED:
            room = self._memory.find(RoomWatch)
            return room is not None and room.approached
        return self._tracker.state is Lifecycle.ACTIVE

    def _look(self) -> None:
        """Read until a reply is late again, or enough were not."""
        with self._tracker.active() as tracker:
            for _ in range(JUDGED):
                tracker.read_frame()
                if isinstance(tracker, TimedTracker) and tracker.replies_s[-1] > LATE_S:
                    return
