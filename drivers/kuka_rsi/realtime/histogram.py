"""Bins of the link's histograms, in microseconds of host time: turnaround and jitter.

Turnaround is from telegram received to reply sent; jitter is a telegram's deviation from
its expected arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log

from drivers.kuka_rsi.realtime.link_state import LinkState
from drivers.kuka_rsi.realtime.mailbox import HISTOGRAM_BINS
from ronna_hw.devices.readings import LinkStatistics

FIRST_EDGE_US = 2.0
RATIO = 1.25  # a bin is a quarter wider than the previous one: the last of 64 ends above 3 s
_SCALE = 1.0 / log(RATIO)

EDGES_US = (0.0, *(FIRST_EDGE_US * RATIO**k for k in range(HISTOGRAM_BINS)))


def bin_of(turnaround_us: float) -> int:
    """Number of the bin for a turnaround; the last one includes everything longer."""
    if turnaround_us < FIRST_EDGE_US:
        return 0
    return min(1 + int(log(turnaround_us / FIRST_EDGE_US) * _SCALE), HISTOGRAM_BINS - 1)


def percentile_us(counts: Sequence[int], share: float) -> float:
    """Turnaround that `share` (0..1) of the cycles stay below, interpolated in its bin; 0 without cycles."""
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
    """The health of the link in the form of the device interface; no counts before a link was opened."""
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
