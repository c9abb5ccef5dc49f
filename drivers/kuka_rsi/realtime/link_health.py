"""Link health: losses, foreign senders, and histograms of turnaround and jitter."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from math import degrees

from drivers.kuka_rsi.realtime.link_state import LinkState
from drivers.kuka_rsi.realtime.mailbox import HISTOGRAM_BINS
from ronna_hw.devices.readings import LinkStatistics
from ronna_hw.vectors import JointVector

DEGRADED_ABOVE = 3  # lost cycles in one stretch
STRETCH_CYCLES = 250  # loss-free cycles after which the count of the stretch restarts (1 s at 4 ms)
WINDOW_CYCLES = 250  # over which the share of lost cycles is judged
UNUSABLE_SHARE = 0.35  # in two consecutive windows: far above 20 %, which is tolerated
UNUSABLE_WINDOWS = 2  # one stall of the host, or one burst, does not fill two
RECOVERED_CYCLES = 1000  # loss-free cycles after which full working speed is allowed again
IPOC_WRAP = 2**32
STALE_CYCLES = 25  # a telegram this far back was overtaken on the way; farther back it belongs to another run
STALE_IN_A_ROW = 3  # more are no coincidence
RESTART_MS = 10_000  # a jump of the time stamp beyond this is another run, not a gap
AXES_AGREE_DEG = 0.1  # between RSI and EKI at the start: they are read at different moments of rest
FIRST_EDGE_US = 2.0
RATIO = 1.25  # a bin is a quarter wider than the previous one: the last of 64 ends above 3 s
EDGES_US = (0.0, *(FIRST_EDGE_US * RATIO**k for k in range(HISTOGRAM_BINS)))


class Losses:
    """Counters of lost telegrams and replies; the arm slows down while `degraded`.

    A telegram that never arrived shows as a gap in the time stamps. A reply that was lost or late shows in
    the controller's own count in the next telegram. The controller also counts the cycles of a gap, since
    they were not answered: only a count beyond the gap means that our last reply was not accepted.
    """

    def __init__(self, cycle_ms: int) -> None:
        self._cycle_ms = cycle_ms
        self._last_ipoc: int | None = None
        self._last_delay = 0
        self._stretch = 0
        self._clean = 0
        self._stale = 0  # consecutive
        self._window = (0, 0)  # cycles and losses of the present one
        self._bad_windows = 0  # consecutive
        self.reported_late = -1  # the controller's own count in the last telegram, -1 if it sends none
        self.lost = 0
        self.late = 0
        self.degraded = False
        self.reply_lost = False  # the last reply had no effect
        self.held_cycles = 0  # consecutive cycles, up to now, without an effective reply

    def count(self, ipoc: int, delay: int) -> int | None:
        """Return the cycles missing before a telegram; -1 if out of sequence, None for another run."""
        if self._last_ipoc is None:
            self._last_ipoc, self._last_delay, self.reported_late = ipoc, max(delay, 0), delay
            return 0
        step = ipoc - self._last_ipoc
        if step < -IPOC_WRAP // 2:
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
        self.lost += missing
        self.late += late
        self.reply_lost = late > missing
        self.held_cycles = missing + self.held_cycles + 1 if self.reply_lost else missing
        self._judge_stretch(max(missing, late))
        self._judge_window(1 + missing, max(missing, late))
        return missing

    @property
    def is_unusable(self) -> bool:
        """Whether losses have been too high for too long to continue any motion."""
        return self._bad_windows >= UNUSABLE_WINDOWS

    def _judge_window(self, cycles: int, losses: int) -> None:
        seen, lost = self._window[0] + cycles, self._window[1] + losses
        if seen < WINDOW_CYCLES:
            self._window = (seen, lost)
            return
        self._bad_windows = self._bad_windows + 1 if lost > UNUSABLE_SHARE * seen else 0
        self._window = (0, 0)

    def _judge_stretch(self, losses: int) -> None:
        if losses:
            self._stretch += losses
            self._clean = 0
            self.degraded |= self._stretch > DEGRADED_ABOVE
            return
        self._clean += 1
        if self._clean >= STRETCH_CYCLES:
            self._stretch = 0
        if self._clean >= RECOVERED_CYCLES:
            self.degraded = False


class SenderCheck:
    """Foreign senders since a stream was opened, counted for error messages."""

    def __init__(self, expected_rad: JointVector | None = None) -> None:
        """Expect these joint angles in the first telegram; with None, any are accepted."""
        self._expected_rad = expected_rad
        self.count = 0
        self.host = ""  # of the last one
        self.disagreeing = 0  # readable telegrams with other axes, before the controller's first
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


def histogram_bin(turnaround_us: float) -> int:
    """Return the histogram bin of a host time in us; the last bin is open-ended."""
    return bisect_right(EDGES_US, turnaround_us, 1, HISTOGRAM_BINS) - 1


def percentile_us(counts: Sequence[int], share: float) -> float:
    """Return the interpolated percentile of a histogram, `share` in 0..1; 0 for an empty one."""
    total = sum(counts)
    if not total:
        return 0.0
    wanted, seen = share * total, 0
    for k, count in enumerate(counts):
        if count and seen + count >= wanted:
            return EDGES_US[k] + (EDGES_US[k + 1] - EDGES_US[k]) * (wanted - seen) / count
        seen += count
    return EDGES_US[-1]


def link_statistics(state: LinkState, counts: Sequence[int], jitter: Sequence[int] = ()) -> LinkStatistics:
    """Convert a link state and its histograms to the statistics of the device interface."""
    return LinkStatistics(
        cycles=state.cycles,
        late_cycles=state.late,
        lost_cycles=state.lost,
        rejected_telegrams=state.rejected,
        turnaround_median_us=percentile_us(counts, 0.5),
        turnaround_p99_us=percentile_us(counts, 0.99),
        histogram_edges_us=EDGES_US,
        histogram_counts=tuple(counts) or (0,) * HISTOGRAM_BINS,
        foreign_telegrams=state.foreign,
        jitter_median_us=percentile_us(jitter, 0.5),
        jitter_p99_us=percentile_us(jitter, 0.99),
        jitter_counts=tuple(jitter) or (0,) * HISTOGRAM_BINS,
    )
