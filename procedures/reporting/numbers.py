"""Number formats of a report, one per quantity."""

from __future__ import annotations

import math
from collections.abc import Iterable

NOT_KNOWN = "–"


def millimetres(value_mm: float | None) -> str:
    """Format a length in millimetres with three decimals."""
    return NOT_KNOWN if value_mm is None else f"{value_mm:.3f}"


def point(values_mm: Iterable[float]) -> str:
    """Format the coordinates of a point in millimetres with three decimals."""
    return " ".join(map(millimetres, values_mm))


def degrees(value_rad: float | None) -> str:
    """Format an angle in degrees with three decimals."""
    return NOT_KNOWN if value_rad is None else f"{math.degrees(value_rad):.3f}"


def tenths(value: float | None) -> str:
    """Format a number with one decimal, for depths in mm and for micrometres."""
    return NOT_KNOWN if value is None else f"{value:.1f}"


def micrometres(value_mm: float | None) -> str:
    """Format a small length in micrometres with one decimal."""
    return NOT_KNOWN if value_mm is None else tenths(1000.0 * value_mm)


def seconds(value_s: float | None) -> str:
    """Format a time in seconds with two decimals."""
    return NOT_KNOWN if value_s is None else f"{value_s:.2f}"
