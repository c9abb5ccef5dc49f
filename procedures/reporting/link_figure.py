"""Turnaround and jitter of the robot's real-time link, over all its streams, on logarithmic axes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

from procedures.reporting.svg import WIDTH, Canvas
from procedures.steps.clinical.results import LinkHealth

TURNAROUND, JITTER, GRID = "#1f6f8b", "#b3541e", "#dfe5e8"
LEAST_SHOWN_US = 1.0  # the first bin begins at zero, which a logarithmic axis does not have
LEFT, HEIGHT, TOP = 44.0, 150.0, 20.0


def summed_histograms(links: Sequence[LinkHealth]) -> list[tuple[float, float, int, int]]:
    """Bins (from us, to us, turnaround, jitter) over all streams; empty ends are dropped."""
    edges = links[0].histogram_edges_us
    alike = [link for link in links if link.histogram_edges_us == edges]
    bins = []
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        turnaround = sum(link.histogram_counts[number] for link in alike)
        jitter = sum(link.jitter_counts[number] for link in alike if link.jitter_counts)
        bins.append((low, high, turnaround, jitter))
    filled = [number for number, one in enumerate(bins) if one[2] or one[3]]
    return bins[filled[0] : filled[-1] + 1] if filled else []


def link_figure(bins: Sequence[tuple[float, float, int, int]]) -> str:
    """Cycles over microseconds of host time: filled for turnaround, a line for jitter."""
    canvas = Canvas(TOP + HEIGHT + 22, "Cycles of the robot link over turnaround and jitter")
    low, high = math.log10(max(bins[0][0], LEAST_SHOWN_US)), math.log10(bins[-1][1])
    most = max(max(one[2], one[3]) for one in bins)
    across = (WIDTH - LEFT - 10) / max(high - low, 1e-6)
    up = HEIGHT / math.log10(most + 1)

    def x(value_us: float) -> float:
        return LEFT + (math.log10(max(value_us, LEAST_SHOWN_US)) - low) * across

    def y(count: int) -> float:
        return TOP + HEIGHT - math.log10(count + 1) * up

    canvas.text(LEFT, 11, "filled: turnaround; line: jitter of the telegrams; cycles")
    for power in range(math.ceil(low), math.floor(high) + 1):
        canvas.line(x(10.0**power), TOP, x(10.0**power), TOP + HEIGHT, GRID)
        canvas.text(x(10.0**power), TOP + HEIGHT + 15, f"{10**power:g} µs", anchor="middle")
    for power in range(len(str(most))):
        canvas.line(LEFT, y(10**power), WIDTH - 10, y(10**power), GRID)
        canvas.text(LEFT - 4, y(10**power) + 4, f"{10**power:g}", anchor="end")
    for begin, end, turnaround, _ in bins:
        canvas.rectangle(x(begin), y(turnaround), x(end) - x(begin), TOP + HEIGHT - y(turnaround), TURNAROUND)
    before = TOP + HEIGHT
    for begin, end, _, jitter in bins:
        canvas.line(x(begin), before, x(begin), y(jitter), JITTER)
        canvas.line(x(begin), y(jitter), x(end), y(jitter), JITTER)
        before = y(jitter)
    return canvas.svg
