"""Recognizes coordinates that were given in metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

NOT_METRES = "give millimetres, not metres"
HEAD_SPAN = 0.5  # metres: wider than any head
TABLE_TRAVEL = 2.0  # metres: how far a series may be from the scanner's origin


def span(points: ArrayLike) -> float:
    """Diagonal of the box around points (n, 3), in their unit."""
    return float(np.linalg.norm(np.ptp(np.asarray(points, dtype=float), axis=0)))


def in_metres(points: ArrayLike) -> bool:
    """Whether points (n, 3), read as millimetres, are so close together that only metres make sense of them.

    One point alone, as drawn first, says nothing about its unit.
    """
    given = np.asarray(points, dtype=float)
    return len(given) > 1 and span(given) < HEAD_SPAN and float(np.abs(given).max()) < TABLE_TRAVEL
