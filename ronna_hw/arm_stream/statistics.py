"""Histograms of turnaround and jitter, and the statistics of the device interface made from them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

from ronna_hw.arm_stream.records import LinkState
from ronna_hw.devices.readings import LinkStatistics

HISTOGRAM_BINS = 64
FIRST_EDGE_US = 2.0
RATIO = 1.25  # a bin is a quarter wider than the previous one: the last of 64 ends above 3 s
EDGES_US = (0.0, *(FIRST_EDGE_US * RATIO**k for k in range(HISTOGRAM_BINS)))


def histogram_bin(turnaround_us: float) -> int:
    """Return the histogram bin of a host time in us; the last bin is open-ended."""
    return bisect_right(EDGES_US, turnaround_us, 1, HISTOGRAM_BINS) - 1


def percentile_us(counts: Sequence[int], share: float) -> float:
    """Return the interpolated percentile of a histogram, `share` in 0..1; 0 for an empty one."""
    if not (total := sum(counts)):
        return 0.0
    wanted, seen = share * total, 0
    for k, count in enumerate(counts):
        if count and seen + count >= wanted:
            return EDGES_US[k] + (EDGES_US[k + 1] - EDGES_US[k]) * (wanted - seen) / count
        seen += count
    return EDGES_US[-1]


def link_statistics(state: LinkState, counts: Sequence[int], jitter: Sequence[int]) -> LinkStatistics:
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
