"""Limits how long the tracker may not see the head while a guide approaches it or an instrument is in it.

A head that moves while every sphere is covered is noticed when one is seen again. This bounds how long that
may take: then the case suspends, and the operator decides whether it continues without sight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from procedures.engine.context import CaseMemory
from procedures.guards.room_reading import check_now
from procedures.guards.room_watch import MOST_UNSEEN_S, RoomWatch
from procedures.operator.question import Topic
from procedures.workcell import Workcell
from ronna_hw.clock import Clock
from ronna_hw.errors import RonnaError

CLEAR_THE_LINE = (
    "clear the line of sight between tracker and head; if only the arm or the guide blocks it, "
    "leave the step and move the tracker or turn the trajectory (free_angle_deg in the plan), or "
    "continue without sight"
)
ARM_IN_THE_WAY = (
    "the arm or the guide blocks the view, as expected; leave the step and move the tracker or turn "
    "the trajectory (free_angle_deg in the plan), or continue without sight"
)
PATIENCE_S = 20.0  # theatre time for a hand or a drape to go; none where the arm itself is in the way


@dataclass
class HeadInSight:
    """Asked at checkpoints. Looks itself once the time is over; `void` ends the localization's standing."""

    workcell: Workcell
    clock: Clock
    memory: CaseMemory
    void: Callable[[RonnaError], None]
    name: str = "head"
    topic: Topic = Topic.HEAD_UNSEEN

    @property
    def patience_s(self) -> float:
        """How long to wait before the operator is asked."""
        room = self.memory.find(RoomWatch)
        return 0.0 if room is not None and room.arm_hides_head else PATIENCE_S

    def unmet(self) -> str | None:
        """Why the head is not watched, once that has lasted. Raises PRO-019, PRO-020, PRO-022."""
        room = self.memory.find(RoomWatch)
        if room is None or not room.overdue(self.clock.now_s()):
            return None
        check_now(room, self.workcell, self.clock, self.memory, self.void)
        now_s = self.clock.now_s()
        if not room.overdue(now_s):
            return None
        why = ARM_IN_THE_WAY if room.arm_hides_head else CLEAR_THE_LINE
        return f"the tracker has not seen the head for {room.unseen_s(now_s):.0f} s: {why}"

    @property
    def excused_for_s(self) -> float:
        """As long as a head may be unseen."""
        return MOST_UNSEEN_S

    def excuse(self) -> None:
        """The operator continues without sight."""
        room = self.memory.find(RoomWatch)
        if room is not None:
            room.excuse()
