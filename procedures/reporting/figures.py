"""Figures of the report, as PNG bytes. matplotlib is imported only when one is drawn."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from procedures.reporting.outcome import TargetOutcome
from procedures.steps.clinical.link_health import LinkHealth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Mean application error of published work on phantoms, mm. Sources in docs/reference/published-figures.md.
PUBLISHED_MM = (
    ("RONNA, OCS, 5 fiducials, phantom", 0.260),
    ("RONNA, JDMS, 5 fiducials, phantom", 0.369),
    ("RONNA, NOS, 5 fiducials, phantom", 1.327),
    ("RONNA G3, targets < 50 mm deep, phantom", 0.43),
    ("RONNA G3, targets 50-120 mm deep, phantom", 0.88),
)
OURS_COLOUR, PREDICTED_COLOUR, PUBLISHED_COLOUR = "#1f6f8b", "#9cc5d3", "#b9b9b9"
LEAST_SHOWN_US = 1.0  # the first bin begins at zero, which a logarithmic axis does not have
JITTER_COLOUR = "#b3541e"
DOTS_PER_INCH = 110


def target_errors(targets: Sequence[TargetOutcome], simulated: bool) -> bytes:
    """Bars: error at each target against truth, prediction beside it, published means below."""
    figure, axes = _figure(7.6, 0.42 * (2 * len(targets) + len(PUBLISHED_MM)) + 1.2)
    labels: list[str] = []
    values: list[float] = []
    colours: list[str] = []
    for target in targets:
        if target.application_error_mm is not None:
            labels.append(f"{target.id}, {target.depth_mm:.0f} mm deep")
            values.append(target.application_error_mm)
            colours.append(OURS_COLOUR)
        labels.append(f"{target.id}, predicted (rms)")
        values.append(target.predicted_tre_mm)
        colours.append(PREDICTED_COLOUR)
    for label, value in PUBLISHED_MM:
        labels.append(label)
        values.append(value)
        colours.append(PUBLISHED_COLOUR)
    places = np.arange(len(labels))[::-1]
    bars = axes.barh(places, values, color=colours)
    axes.bar_label(bars, fmt="%.2f", padding=3, fontsize=8)
    axes.set_yticks(places, labels, fontsize=8)
    axes.set_xlim(0, 1.15 * max(values))
    axes.set_xlabel("error of the needle tip, mm" + (" (this run: simulated)" if simulated else ""))
    return _png(figure)


def cycle_histogram(links: Sequence[LinkHealth]) -> bytes:
    """Histogram of turnaround and jitter of the robot link over all its sessions; empty ends are left out."""
    figure, axes = _figure(7.6, 2.6)
    edges = np.array(links[0].histogram_edges_us)
    turnaround = np.sum([link.histogram_counts for link in links], axis=0)
    jitter = np.zeros_like(turnaround)
    for link in links:
        jitter += np.array(link.jitter_counts or np.zeros_like(turnaround))
    filled = np.flatnonzero(turnaround + jitter)
    first, last = (filled[0], filled[-1] + 1) if len(filled) else (0, len(turnaround))
    edges, turnaround, jitter = edges[first : last + 1], turnaround[first:last], jitter[first:last]
    edges[0] = max(edges[0], LEAST_SHOWN_US)
    axes.bar(
        edges[:-1], turnaround, width=np.diff(edges), align="edge", color=OURS_COLOUR, label="turnaround"
    )
    if jitter.any():
        axes.stairs(jitter, edges, color=JITTER_COLOUR, label="jitter of the telegrams")
        axes.legend(frameon=False, fontsize=8)
    axes.set_yscale("symlog", linthresh=1)
    axes.set_xscale("log")
    axes.set_xlabel("µs of host time")
    axes.set_ylabel("cycles")
    return _png(figure)


def _figure(width_in: float, height_in: float) -> tuple[Figure, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure, axes


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH)
    return buffer.getvalue()
