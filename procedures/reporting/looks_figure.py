"""Residual of each view of a calibration, in the order in which they were taken."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.reporting.svg import WIDTH, Canvas

USED, LEFT_OUT, GRID = "#1f6f8b", "#b3261e", "#dfe5e8"
LEFT, TOP, HEIGHT = 44.0, 20.0, 120.0
GAP = 0.2  # of a bar's width


def looks_figure(looks_px: Sequence[tuple[float, bool]]) -> str:
    """A bar for each view, its rms in px; red: left out, and cut at the height of the picture."""
    canvas = Canvas(TOP + HEIGHT + 18, "Rms residual of each measurement, px")
    highest_px = max((value for value, used in looks_px if used), default=1.0)
    across, up = (WIDTH - LEFT) / len(looks_px), HEIGHT / max(highest_px, 1e-6)
    for value_px in (0.0, highest_px / 2, highest_px):
        y = TOP + HEIGHT - value_px * up
        canvas.line(LEFT, y, WIDTH, y, GRID)
        canvas.text(LEFT - 4, y + 4, f"{value_px:.2f}", anchor="end")
    canvas.text(LEFT, 11, "rms of each measurement, px; red: left out")
    for number, (value_px, used) in enumerate(looks_px):
        height = min(value_px, highest_px) * up
        canvas.rectangle(
            LEFT + number * across,
            TOP + HEIGHT - height,
            across * (1 - GAP),
            height,
            USED if used else LEFT_OUT,
            title=f"measurement {number + 1}: {value_px:.2f} px",
        )
    canvas.text(LEFT, TOP + HEIGHT + 14, "1", anchor="start")
    canvas.text(WIDTH, TOP + HEIGHT + 14, str(len(looks_px)), anchor="end")
    return canvas.svg
