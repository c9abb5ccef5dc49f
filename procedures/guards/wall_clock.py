"""The wall clock against the monotonic one: it dates the records, and a step of it makes their dates wrong.

No limit depends on the wall clock, so a jump stops nothing: it is a finding.
"""

from __future__ import annotations

import time
from collections.abc import Callable

LARGEST_STEP_S = 1.0  # a clock that is slewed stays below that between two checkpoints


class WallClock:
    """Notices that the host's clock was changed."""

    name = "clock"

    def __init__(
        self,
        find: Callable[[str], None],
        wall_s: Callable[[], float] = time.time,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find = find
        self._wall_s, self._monotonic_s = wall_s, monotonic_s
        self._ahead_s = wall_s() - monotonic_s()

    def unmet(self) -> None:
        """Never; what is noticed is a finding."""
        ahead_s = self._wall_s() - self._monotonic_s()
        step_s = ahead_s - self._ahead_s
        if abs(step_s) > LARGEST_STEP_S:
            self._ahead_s = ahead_s
            self._find(
                f"the host's clock was changed by {step_s:+.1f} s: dates before and after do not agree; "
                "durations and limits are not affected"
            )
