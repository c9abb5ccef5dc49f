"""The dials of a tool's gauge as written down, one line for each approach."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ronna_hw.bounded_input import read_bounded
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.tool_record import GAUGE_APPROACHES, GAUGE_MOUNTINGS, Gauge

DIALS = ("X", "Y", "Z", "UPPER_X", "UPPER_Y")
LARGEST_BYTES = 100_000
# Six standard deviations of an arm's arrival, a changer's seat and a dial together: farther is misread.
APART_MM = 0.1


def read_gauge(path: Path, gauge: Gauge) -> dict[str, Any]:
    """Their mean and spread, as fields of the gauge. Raises CLI-001 for too few, or what no dial shows."""
    lines = read_bounded(path, LARGEST_BYTES).decode("utf-8-sig", "replace").splitlines()
    read = [_numbers(f"{path.name}:{number}", line) for number, line in enumerate(lines, 1) if line.strip()]
    if len(read) < GAUGE_APPROACHES:
        raise UsageMistake(
            f"--gauge-mm: {path.name} has {len(read)} approaches",
            expected=f"at least {GAUGE_APPROACHES}, in {GAUGE_MOUNTINGS} mountings",
            action="One line for each approach: the five dials in mm.",
        )
    lowest_mm, highest_mm = gauge.plausible_mm
    middle = np.median([numbers for _, numbers in read], axis=0).tolist()
    for where, numbers in read:
        for dial, reading_mm, usual_mm in zip(DIALS, numbers, middle, strict=True):
            if not lowest_mm <= reading_mm <= highest_mm:
                raise UsageMistake(
                    f"--gauge-mm: {where}: {dial} is {reading_mm:g}",
                    expected=f"{lowest_mm:g} to {highest_mm:g} mm: a dial travels {gauge.travel_mm:g} mm",
                    action="Read the dials again; if their travel differs, set `travel_mm` of the gauge.",
                )
            if abs(reading_mm - usual_mm) > APART_MM:
                raise UsageMistake(
                    f"--gauge-mm: {where}: {dial} is {reading_mm:g}",
                    expected=f"within {APART_MM:g} mm of the others, whose median is {usual_mm:g}",
                    action="Seat tool and mandrel anew, and read all approaches again.",
                )
    values = np.array([numbers for _, numbers in read])
    x, y, z, upper_x, upper_y = values.mean(axis=0).round(6).tolist()
    return {
        "reading_mm": [x, y, z],
        "upper_reading_mm": [upper_x, upper_y],
        "approaches": len(values),
        "spread_mm": round(float(np.sqrt(values.var(axis=0, ddof=1).mean())), 6),
    }


def _numbers(where: str, line: str) -> tuple[str, list[float]]:
    """One line, with its place for messages. A number that is not finite is outside every dial's travel."""
    try:
        numbers = [float(word) for word in line.split()] if line.isascii() and "_" not in line else []
    except ValueError:
        numbers = []
    if len(numbers) != len(DIALS):
        raise UsageMistake(
            f"--gauge-mm: {where}: {line.strip()[:40]!r}",
            expected=f"five numbers, {' '.join(DIALS)}",
            action="Write them with decimal points, and spaces between them.",
        )
    return where, numbers
