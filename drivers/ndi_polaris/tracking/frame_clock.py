"""The unit's clock: frame numbers at 60 per second, fitted to theatre time by a line.

The delay of a reply is never negative, so the replies with the least delay are on the lower edge of time over
frame number. The least delayed reply of each second is kept; the slope is the median over all pairs of these
(Theil-Sen), the intercept that of the lowest line with no reply below it. The delay common to all replies,
the unit's processing and the transfer, cannot be separated from it.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import combinations
from statistics import median

from ronna_hw.wire.polaris import FRAME_RATE_HZ, TX_FRAME_DIGITS

FRAME_NUMBERS = 16**TX_FRAME_DIGITS  # the number wraps after 2.3 years
NOMINAL_PERIOD_S = 1.0 / FRAME_RATE_HZ
WINDOW_FRAMES = 60  # one second: long enough to contain a reply with hardly any delay
WINDOWS_KEPT = 60  # a minute; the drift of a quartz is steady for longer
LEAST_WINDOWS = 10  # with fewer the jitter dominates the slope
LARGEST_DRIFT = 1e-3  # a quartz is within 1e-4; beyond this the nominal rate is the better estimate
JUMP_S = 1.0  # a reply this early means that another client has reset the counter


class FrameClock:
    """Frame numbers of one run of tracking, unwrapped and fitted to theatre time."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._kept: deque[tuple[int, float]] = deque(maxlen=WINDOWS_KEPT)
        self._window = 0
        self._earliest: tuple[int, float] | None = None  # of the current window
        self._earliest_origin_s = math.inf
        self._origin_s: float | None = None
        self.period_s = NOMINAL_PERIOD_S  # of a frame, in theatre time

    def note(self, count: int, arrived_s: float) -> float:
        """Add a reply for frame `count`; returns the fitted theatre time of that frame."""
        if self._origin_s is not None and arrived_s < self._time_s(self._origin_s, count) - JUMP_S:
            self._begin()
        window = count // WINDOW_FRAMES
        if window != self._window:
            self._window = window
            self._end_window()
        origin_s = arrived_s - count * self.period_s
        if origin_s < self._earliest_origin_s:
            self._earliest, self._earliest_origin_s = (count, arrived_s), origin_s
        if self._origin_s is None or origin_s < self._origin_s:
            self._origin_s = origin_s
        return self._time_s(self._origin_s, count)

    def _time_s(self, origin_s: float, count: int) -> float:
        return origin_s + count * self.period_s

    def _end_window(self) -> None:
        if self._earliest is None:
            return
        self._kept.append(self._earliest)
        self._earliest, self._earliest_origin_s = None, math.inf
        if len(self._kept) >= LEAST_WINDOWS:
            slope_s = median((b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._kept, 2))
            drift = slope_s / NOMINAL_PERIOD_S - 1.0
            self.period_s = slope_s if abs(drift) <= LARGEST_DRIFT else NOMINAL_PERIOD_S
        self._origin_s = min(arrived - count * self.period_s for count, arrived in self._kept)


def counted_on(number: int, last: int | None) -> int:
    """The unwrapped frame number: the count nearest to `last` that is congruent to `number`.

    A result below `last` is an older frame.
    """
    if last is None:
        return number
    half = FRAME_NUMBERS // 2
    return last + (number - last + half) % FRAME_NUMBERS - half
