"""Error and prediction at each target next to published results, as one picture."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.reporting.numbers import millimetres
from procedures.reporting.svg import WIDTH, Canvas
from procedures.reporting.target_table import TargetRow

# Mean application error of published work on phantoms, mm. Sources in docs/reference/published-figures.md.
PUBLISHED_MM = (
    ("RONNA, OCS, 5 fiducials, phantom", 0.260),
    ("RONNA, JDMS, 5 fiducials, phantom", 0.369),
    ("RONNA, NOS, 5 fiducials, phantom", 1.327),
    ("RONNA G3, targets < 50 mm deep, phantom", 0.43),
    ("RONNA G3, targets 50-120 mm deep, phantom", 0.88),
)
OURS, PREDICTED, PUBLISHED = "#1f6f8b", "#9cc5d3", "#b9b9b9"
ROW, BAR, VALUE_ROOM = 31.0, 12.0, 70.0  # heights of a row and of its bar; room for the number after it


def target_figure(rows: Sequence[TargetRow], simulated: bool) -> str:
    """Bars with their numbers, in mm."""
    bars: list[tuple[str, float, str]] = []
    for row in rows:
        if row.error_mm is not None:
            measured = "against the simulated truth" if simulated else "measured"
            bars.append((f"{row.target}: {measured}", row.error_mm, OURS))
        bars.append((f"{row.target}: predicted, rms", row.predicted.rms_mm, PREDICTED))
    bars += [(name, value, PUBLISHED) for name, value in PUBLISHED_MM]
    canvas = Canvas(ROW * len(bars) + 4, "Error of the needle tip at the targets, mm")
    scale = (WIDTH - VALUE_ROOM) / max(value for _, value, _ in bars)
    for number, (label, value, colour) in enumerate(bars):
        top = ROW * number
        canvas.text(0, top + 12, label)
        canvas.rectangle(0, top + 16, value * scale, BAR, colour)
        canvas.text(value * scale + 4, top + 26, f"{millimetres(value)} mm")
    return canvas.svg
