"""Guards on the tracker: reply delay, and visibility of the head and the frame on the arm.

A late frame shows a head, or a hand, as it was before. A head that moves while every sphere is covered is
noticed only when one is seen again; `HeadInSight` bounds how long that may take while a guide approaches or
an instrument is inside. Then the case suspends, and the operator decides whether to continue without sight.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from procedures.engine.setting import CaseMemory
from procedures.guards.head_sight import MOST_UNSEEN_S
from procedures.guards.room_watch import RoomWatch, check_now
from procedures.operator.question import Topic
from procedures.workcell import Workcell
from ronna_hw.devices import OpticalTracker
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.sensors import TimedTracker
from ronna_hw.errors import RonnaError

# From request to reply without the transfer, so that a slow serial line does not count as late: at 9600 baud
# a frame of 170 bytes takes 0.18 s. A tracker replies within 0.02 s, and a computer stalls for tens of
# milliseconds. The patient watch averages eight readings: with this delay it notices a shift within a second.
# Safety against a tracker whose replies are old (U).
LATE_S = 0.1

JUDGED = 5  # replies, by their median: two may be late, such as the first and one during a stall
BETWEEN_LOOKS_S = 10.0  # theatre time while replies are late; a look then takes three of them
# Safety against a blocked line of sight (U).
FRAME_PATIENCE_S = 0.2  # theatre time: a passing hand is no finding (12 frames of a 60 Hz tracker)

CLEAR_THE_LINE = (
    "clear the line of sight between tracker and head; if only the arm or the guide blocks it, "
    "leave the step and move the tracker or turn the trajectory (free_angle_deg in the plan), or "
    "continue without sight"
)
ARM_IN_THE_WAY = (
    "the arm or the guide blocks the view, as expected; leave the step and move the tracker or turn "
    "the trajectory (free_angle_deg in the plan), or continue without sight"
)
# Safety against a blocked line of sight (U).
PATIENCE_S = 20.0  # theatre time for a hand or a drape to go; none if the arm itself is in the way


def late_s(tracker: OpticalTracker) -> float | None:
    """Return the reply delay if it is too long, or None if acceptable or not reported."""
    if not isinstance(tracker, TimedTracker):
        return None
    last_s = tracker.replies_s[-JUDGED:]
    usual_s = median(last_s) if len(last_s) == JUDGED else 0.0
    return usual_s if usual_s > LATE_S else None


@dataclass
class TrackerLink:
    """Guard for the tracker's reply delay. While replies are late, the guard reads frames itself."""

    tracker: OpticalTracker
    memory: CaseMemory
    now_s: Callable[[], float]  # theatre time
    name: str = "tracker link"
    _looked_s: float = -math.inf

    def unmet(self) -> str | None:
        """Describe late replies while a step reads the tracker or a guide is at or approaching the head."""
        if not self._in_use or late_s(self.tracker) is None:
            return None
        if self.now_s() - self._looked_s >= BETWEEN_LOOKS_S:
            with contextlib.suppress(RonnaError):  # a lost reply; what lasts is latched by the tracker
                self._look()
            self._looked_s = self.now_s()
        late = late_s(self.tracker)
        if late is None:
            return None
        return (
            f"the tracker replies after {late:.2f} s, limit {LATE_S:g} s, and a head that moves would be "
            "noticed late: check its cable and adapter, close other programs on this computer"
        )

    @property
    def _in_use(self) -> bool:
        """Whether the tracker is needed now. The way out does not need it."""
        if self.tracker.state is Lifecycle.CONFIGURED:
            room = self.memory.find(RoomWatch)
            return room is not None and room.head_sight.under_way
        return self.tracker.state is Lifecycle.ACTIVE

    def _look(self) -> None:
        """Read frames until one reply is late or enough are on time."""
        with self.tracker.active() as tracker:
            for _ in range(JUDGED):
                tracker.read_frame()
                if isinstance(tracker, TimedTracker) and tracker.replies_s[-1] > LATE_S:
                    return


@dataclass
class LineOfSight:
    """Guard for the line of sight to the reference frame. If it is lost, the guard reads frames itself."""

    tracker: OpticalTracker
    frame: str  # the tracker's name for the reference frame
    now_s: Callable[[], float]  # theatre time
    name: str = "line of sight"
    _lost_since_s: float | None = None

    def unmet(self) -> str | None:
        """Describe why the frame's pose has been unavailable for too long."""
        if self.tracker.state is not Lifecycle.ACTIVE or self._validity() is Validity.OK:
            self._lost_since_s = None
            return None
        now_s = self.now_s()
        if self._lost_since_s is None:
            self._lost_since_s = now_s
        if now_s - self._lost_since_s < FRAME_PATIENCE_S:
            return None
        with contextlib.suppress(RonnaError):  # a lost reply; what lasts is latched by the tracker
            self.tracker.read_frame()
        if self._validity() is Validity.OK:
            self._lost_since_s = None
            return None
        return (
            f"the tracker does not see the reference frame {self.frame} ({self._validity()}): clear "
            "the line of sight between tracker and arm"
        )

    def _validity(self) -> Validity:
        frame = self.tracker.observe().reading
        return Validity.OK if frame is None else frame.tool(self.frame).validity


@dataclass
class HeadInSight:
    """Guard for the line of sight to the head. Checks the room on timeout.

    `void` ends a localization, `find` records a finding.
    """

    workcell: Workcell
    memory: CaseMemory
    void: Callable[[RonnaError], None]
    find: Callable[[str], None] = lambda _text: None
    name: str = "head"
    topic: Topic = Topic.HEAD_UNSEEN

    @property
    def patience_s(self) -> float:
        """Theatre time to wait before the operator is asked."""
        room = self.memory.find(RoomWatch)
        return 0.0 if room is not None and room.head_sight.is_hidden_by_arm else PATIENCE_S

    def unmet(self) -> str | None:
        """Describe why the head has been unseen for too long. Raises as `RoomLook.require`."""
        room = self.memory.find(RoomWatch)
        if room is None or not room.head_sight.is_overdue(self.workcell.clock.now_s()):
            return None
        look = check_now(room, self.workcell, self.memory, self.void)
        for finding in look.findings:
            self.find(finding)
        now_s = self.workcell.clock.now_s()
        if not room.head_sight.is_overdue(now_s):
            return None
        why = ARM_IN_THE_WAY if room.head_sight.is_hidden_by_arm else CLEAR_THE_LINE
        return f"the tracker has not seen the head for {room.head_sight.unseen_s(now_s):.0f} s: {why}"

    @property
    def excused_for_s(self) -> float:
        """Theatre time for which the operator's excuse remains valid."""
        return MOST_UNSEEN_S

    def excuse(self) -> None:
        """Continue without sight, as the operator decided."""
        room = self.memory.find(RoomWatch)
        if room is not None:
            room.head_sight.excuse()
