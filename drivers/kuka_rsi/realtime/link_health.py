"""Losses by the time stamps and the controller's own count, and senders other than the controller."""

from __future__ import annotations

from math import degrees

from ronna_hw.arm_stream.losses import LossCount
from ronna_hw.arm_stream.session import Senders
from ronna_hw.vectors import JointVector

IPOC_WRAP = 2**32
STALE_CYCLES = 25  # a telegram this far back was overtaken on the way; farther back it belongs to another run
STALE_IN_A_ROW = 3  # more are no coincidence
RESTART_MS = 10_000  # a jump of the time stamp beyond this is another run, not a gap
AXES_AGREE_DEG = 0.1  # between RSI and EKI at the start: they are read at different moments of rest


class Losses(LossCount):
    """Counters of lost telegrams and replies of an RSI stream.

    A telegram that never arrived shows as a gap in the time stamps. A reply that was lost or late shows in
    the controller's own count in the next telegram.
    """

    def __init__(self, cycle_ms: int) -> None:
        super().__init__()
        self._cycle_ms = cycle_ms
        self._last_ipoc: int | None = None
        self._last_delay = 0
        self._stale = 0  # consecutive
        self.reported_late = -1  # the controller's own count in the last telegram, -1 if it sends none

    def count(self, ipoc: int, delay: int) -> int | None:
        """Return the cycles missing before a telegram; -1 if out of sequence, None for another run."""
        if self._last_ipoc is None:
            self._last_ipoc, self._last_delay, self.reported_late = ipoc, max(delay, 0), delay
            return 0
        if (step := ipoc - self._last_ipoc) < -IPOC_WRAP // 2:
            step += IPOC_WRAP
        if -STALE_CYCLES * self._cycle_ms <= step <= 0:
            self._stale += 1
            return -1 if self._stale <= STALE_IN_A_ROW else None
        if not 0 < step < RESTART_MS:
            return None
        self._last_ipoc, self._stale = ipoc, 0
        missing = max(round(step / self._cycle_ms) - 1, 0)
        late = 0
        if delay >= 0:
            late = max(delay - self._last_delay, 0)
            self._last_delay = self.reported_late = delay
        self.note(missing, late)
        return missing


class SenderCheck(Senders):
    """Foreign senders since a stream was opened, counted for error messages."""

    def __init__(self, expected_rad: JointVector | None = None) -> None:
        """Expect these joint angles in the first telegram; with None, any are accepted."""
        self._expected_rad = expected_rad
        self.foreign_sent_last = False  # a stranger sent after the controller's last telegram

    def count_foreign(self, host: str) -> None:
        """Count a telegram from a foreign sender."""
        self.count += 1
        self.host = host
        self.foreign_sent_last = True

    def matches_expected(self, axes_deg: JointVector) -> bool:
        """Return whether a candidate first telegram has the expected joint angles."""
        expected = self._expected_rad
        if expected is None or all(
            abs(axis - degrees(angle)) <= AXES_AGREE_DEG
            for axis, angle in zip(axes_deg, expected, strict=True)
        ):
            return True
        self.disagreeing += 1
        return False
