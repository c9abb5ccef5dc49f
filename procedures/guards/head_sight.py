"""Time for which the tracker has not seen the head, bounded while a guide approaches it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

# Theatre time for which a guide may approach an unseen head. The approach to a target takes some 5 s.
# Safety against the approach to a head that nobody sees (U).
MOST_UNSEEN_S = 10.0


@dataclass
class Approach:
    """Guide approach to the head, along this trajectory if any.

    `excused_s` is when the operator last continued without line of sight. The time without
    sight is bounded only while it is under way: nothing holds up the way out.
    """

    arm_hides_head: Callable[[], bool]
    trajectory: str | None = None
    under_way: bool = False
    excused_s: float = -math.inf


@dataclass
class HeadSight:
    """When the head was last seen in its place (theatre time), and the approach for which that counts."""

    seen_s: float = 0.0
    approach: Approach | None = None

    def unseen_s(self, now_s: float) -> float:
        """Return the theatre time since the head was seen or the operator continued without sight."""
        excused_s = -math.inf if self.approach is None else self.approach.excused_s
        return now_s - max(self.seen_s, excused_s)

    def excuse(self) -> None:
        """Continue without line of sight. The unseen time restarts with the next motion or wait."""
        if self.approach is not None:
            self.approach.excused_s = math.inf

    def begin_motion(self, now_s: float) -> None:
        """Record the start of a motion or wait."""
        if self.approach is not None:
            self.approach.excused_s = min(self.approach.excused_s, now_s)

    def is_overdue(self, now_s: float) -> bool:
        """Return whether a guide is approaching a head that has been unseen for too long."""
        return self.is_approached and self.unseen_s(now_s) > MOST_UNSEEN_S

    @property
    def is_approached(self) -> bool:
        """Whether a guide is approaching the head or is in position in front of it."""
        return self.approach is not None and self.approach.under_way

    @property
    def is_hidden_by_arm(self) -> bool:
        """Whether the arm's present pose is expected to hide the head from the tracker."""
        return self.approach is not None and self.approach.arm_hides_head()
