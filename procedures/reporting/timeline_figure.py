"""Steps, motions and pauses in theatre time, one row per step in order of their beginning."""

from __future__ import annotations

import math
from collections.abc import Sequence

from procedures.reporting.numbers import seconds
from procedures.reporting.svg import WIDTH, Canvas
from procedures.reporting.timeline import Span

STEP, MOTION, REST, BROKEN, GRID = "#d3e3e9", "#1f6f8b", "#e0a030", "#b3261e", "#dfe5e8"
ROW, BAR, AXIS, MARGIN = 30.0, 11.0, 20.0, 12.0
LEAST_WIDTH = 1.5  # so that what took no theatre time is still visible
MOST_TICKS = 6


def timeline_figure(spans: Sequence[Span]) -> str:
    """Light: the step; dark: the arm moves; amber: the case is paused; red: ended abnormally."""
    rows = list(dict.fromkeys(span.row for span in spans))
    begin_s = min(span.begin_s for span in spans)
    length_s = max(max(span.end_s for span in spans) - begin_s, 1e-3)
    scale = (WIDTH - 2 * MARGIN) / length_s
    height = ROW * len(rows) + AXIS
    canvas = Canvas(height, "Steps and motions in theatre time, s")
    for tick_s in _ticks(length_s):
        x = MARGIN + tick_s * scale
        canvas.line(x, 0, x, height - AXIS + 4, GRID)
        canvas.text(x, height - 5, f"{tick_s:g} s", anchor="middle")
    for number, row in enumerate(rows):
        top = ROW * number
        mine = [span for span in spans if span.row == row]
        lasted_s = sum(span.end_s - span.begin_s for span in mine if span.kind == "step")
        canvas.text(MARGIN, top + 12, f"{row}, {seconds(lasted_s)} s")
        for kind, inset in (("step", 0.0), ("motion", 2.0), ("rest", 2.0)):
            for span in mine:
                if span.kind == kind:
                    canvas.rectangle(
                        MARGIN + (span.begin_s - begin_s) * scale,
                        top + 16 + inset,
                        max((span.end_s - span.begin_s) * scale, LEAST_WIDTH),
                        BAR - 2 * inset,
                        _colour(span),
                        title=f"{span.name}: {seconds(span.begin_s)} to {seconds(span.end_s)} s, "
                        f"{span.ended}",
                    )
    return canvas.svg


def _colour(span: Span) -> str:
    if span.kind == "rest":
        return REST
    if span.ended != "done":
        return BROKEN
    return STEP if span.kind == "step" else MOTION


def _ticks(length_s: float) -> list[float]:
    """Round times from zero, at most `MOST_TICKS`."""
    magnitude = 10.0 ** math.floor(math.log10(length_s / MOST_TICKS))
    step = next(f * magnitude for f in (1, 2, 5, 10, 20) if length_s / (f * magnitude) <= MOST_TICKS - 1)
    return [number * step for number in range(int(length_s / step) + 1)]
