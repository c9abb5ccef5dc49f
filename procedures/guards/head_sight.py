"""Time for which the tracker has not seen the head, bounded while a guide approaches it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

# Theatre time for which a guide may approach an unseen head. The approach to a target takes some 5 s.
# Safety against the approach to a head that nobody sees (U).
MOST_UNSEEN_S = 10.0


@dataclass
class HeadSight:
    """When the head was last seen in its place (theatre time), and the approach for which that counts.

    `hides_head` tells whether the arm of an approach hides the head, None without one. Without sight, the
    time is bounded only while the approach, along `trajectory` if any, is `under_way`: nothing holds up the
    way out. `excused_s` is when the operator last continued without line of sight.
    """

    seen_s: float = 0.0
    hides_head: Callable[[], bool] | None = None
    trajectory: str | None = None
    under_way: bool = False
    excused_s: float = -math.inf

    def expect_approach(self, hides_head: Callable[[], bool], trajectory: str | None = None) -> None:
        """Expect a guide that approaches the head, with nothing excused so far."""
        self.hides_head, self.trajectory = hides_head, trajectory
        self.under_way, self.excused_s = False, -math.inf

    def unseen_s(self, now_s: float) -> float:
        """Return the theatre time since the head was seen or the operator continued without sight."""
        return now_s - max(self.seen_s, self.excused_s)

    def excuse(self) -> None:
        """Continue without line of sight. The unseen time restarts with the next motion or wait."""
        self.excused_s = math.inf

    def begin_motion(self, now_s: float) -> None:
        """Record the start of a motion or wait."""
        self.excused_s = min(self.excused_s, now_s)

    def is_overdue(self, now_s: float) -> bool:
        """Return whether a guide is approaching a head that has been unseen for too long."""
        return self.under_way and self.unseen_s(now_s) > MOST_UNSEEN_S

    @property
    def is_hidden_by_arm(self) -> bool:
        """Whether the arm's present pose is expected to hide the head from the tracker."""
        return self.hides_head is not None and self.hides_head()
