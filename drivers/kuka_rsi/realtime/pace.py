"""Predicts when the next telegram is due, since the controller keeps an absolute schedule.

The pace is learnt from arrivals alone. A telegram may be delayed on its way, but never arrives before it was
sent: an early one corrects the schedule at once, a late one only slightly.
"""

from __future__ import annotations

STEADY_ARRIVALS = 8  # consecutive arrivals near their predictions before the next prediction is trusted
NEAR_SHARE = 0.25  # of the interval: a larger deviation means another schedule
MOST_MISSING = 25  # consecutive telegrams over which the schedule is kept
# Shares of a deviation applied to the schedule's phase and interval: two clocks never run alike.
EARLY_GAINS = (1.0, 1.0 / 32.0)
LATE_GAINS = (1.0 / 16.0, 1.0 / 256.0)


class Pace:
    """Fed with every arrival, host time in ns."""

    def __init__(self) -> None:
        self._place_ns = 0.0  # scheduled time of the last arrival
        self._interval_ns = 0.0
        self._steady = 0

    @property
    def due_ns(self) -> int:
        """When the next telegram arrives unless delayed; 0 while no schedule is known."""
        return int(self._place_ns + self._interval_ns) if self._steady >= STEADY_ARRIVALS else 0

    def arrived(self, now_ns: int) -> None:
        """A telegram has arrived."""
        gap_ns, interval_ns = now_ns - self._place_ns, self._interval_ns
        steps = round(gap_ns / interval_ns) if interval_ns else 0
        off_ns = gap_ns - steps * interval_ns
        if not 1 <= steps <= MOST_MISSING + 1 or abs(off_ns) > NEAR_SHARE * interval_ns:
            self._steady, self._place_ns, self._interval_ns = 0, float(now_ns), float(gap_ns)
            return
        self._steady += 1
        place_gain, interval_gain = LATE_GAINS if off_ns > 0.0 else EARLY_GAINS
        self._place_ns = now_ns - (1.0 - place_gain) * off_ns
        self._interval_ns += interval_gain * off_ns / steps

    def forget(self) -> None:
        """Discard the schedule."""
        self._steady, self._interval_ns = 0, 0.0
