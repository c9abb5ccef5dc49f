"""Reasons to doubt that something is a marker, and the resulting odds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

STEEPNESS = 4.0  # at twice a limit the odds are 1 to 16
EVEN = 0.5
WORTH_TELLING = 0.5  # of a limit


@dataclass(frozen=True)
class Doubt:
    """Why something may not be a marker; at an `excess` of 1 that alone makes the odds even."""

    reason: str
    excess: float


def odds(doubts: Iterable[Doubt]) -> float:
    """Odds [0..1] of a marker given all doubts: a score, with each limit at even odds."""
    return float(np.prod([1.0 / (1.0 + doubt.excess**STEEPNESS) for doubt in doubts]))


def reasons(doubts: Iterable[Doubt]) -> str:
    """The significant ones in words, most serious first."""
    gravest = sorted(doubts, key=lambda doubt: -doubt.excess)
    return ", ".join(doubt.reason for doubt in gravest if doubt.excess > WORTH_TELLING)
