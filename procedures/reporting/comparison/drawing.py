"""Drawing of the errors at the targets of two runs."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.reporting.comparison.results import ComparedTarget
from procedures.reporting.numbers import millimetres
from procedures.reporting.pictures import BLUE, GREEN, GRID, HEADING_ROW, TEXT_SIZE, VALUE_ROOM, WIDTH, Canvas

FIRST, SECOND = BLUE, GREEN
BAR, ROW = 10.0, 15.0
LABEL_ROOM = 120.0
VALUE_LABEL = 60.0  # width of a figure with its unit
LIMIT = 'stroke="currentColor" stroke-width="2"'


def compared_targets_figure(targets: Sequence[ComparedTarget], names: tuple[str, str]) -> str:
    """Draw the known error of each target as a bar, with a tick at the limit of the prediction, in mm.

    Without a known error the bar ends at the predicted rms. Empty if neither run has a prediction.
    """
    bars = [
        (target.name, row, name, colour)
        for target in targets
        for row, name, colour in zip(target.rows, names, (FIRST, SECOND), strict=True)
        if row is not None
    ]
    if not bars:
        return ""
    largest_mm = max(max(row.error_mm or 0.0, row.predicted.limit_mm) for _, row, _, _ in bars)
    scale = (WIDTH - LABEL_ROOM - VALUE_ROOM) / max(largest_mm, 1e-6)
    groups = list(dict.fromkeys(name for name, *_ in bars))
    canvas = Canvas(HEADING_ROW * len(groups) + ROW * len(bars) + 4, "Errors at the targets of both runs, mm")
    top = 0.0
    for group in groups:
        canvas.text(0, top + 14, group)
        canvas.line(0, top + 19, WIDTH, top + 19, GRID)
        top += HEADING_ROW
        for name, row, run, colour in bars:
            if name != group:
                continue
            known = row.error_mm is not None
            value_mm = row.error_mm if row.error_mm is not None else row.predicted.rms_mm
            canvas.text(0, top + TEXT_SIZE, f"{run}, {'error' if known else 'predicted rms'}")
            canvas.rectangle(LABEL_ROOM, top + 2, value_mm * scale, BAR, colour)
            at = LABEL_ROOM + row.predicted.limit_mm * scale
            canvas.line(at, top, at, top + ROW - 2, LIMIT)
            end, value = LABEL_ROOM + value_mm * scale, f"{millimetres(value_mm)} mm"
            limit = f"limit {millimetres(row.predicted.limit_mm)}"
            if end + VALUE_LABEL < at:
                canvas.text(end + 4, top + TEXT_SIZE, value)
                canvas.text(at + 4, top + TEXT_SIZE, limit)
            else:
                canvas.text(max(end, at) + 4, top + TEXT_SIZE, f"{value}, {limit}")
            top += ROW
    return canvas.svg
