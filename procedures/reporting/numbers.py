"""How numbers are written in a report: one format per kind, never truncated."""

from __future__ import annotations

import math

NOT_KNOWN = "–"


def millimetres(value_mm: float | None) -> str:
    """Three decimals: a micrometre."""
    return NOT_KNOWN if value_mm is None else f"{value_mm:.3f}"


def degrees(value_rad: float) -> str:
    """Three decimals: a fiftieth of a milliradian."""
    return f"{math.degrees(value_rad):.3f}"


def tenths(value: float | None) -> str:
    """One decimal, for depths in mm and for micrometres."""
    return NOT_KNOWN if value is None else f"{value:.1f}"


def micrometres(value_mm: float | None) -> str:
    """A small length in mm as micrometres, one decimal."""
    return NOT_KNOWN if value_mm is None else tenths(1000.0 * value_mm)


def seconds(value_s: float | None) -> str:
    """Two decimals."""
    return NOT_KNOWN if value_s is None else f"{value_s:.2f}"
