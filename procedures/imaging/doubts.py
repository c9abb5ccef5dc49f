"""Reasons to doubt that something is a marker, and the odds that remain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

STEEPNESS = 4.0  # at twice a limit the odds are 1 to 16
EVEN = 0.5
WORTH_TELLING = 0.5  # of a limit


@dataclass(frozen=True)
class Doubt:
    """Why something may not be a marker; `excess` is 1 where that alone makes the odds even."""

    reason: str
    excess: float


def odds(doubts: Iterable[Doubt]) -> float:
    """Odds [0..1] of a marker in the face of all doubts: a score, with a limit at even odds for each."""
    return float(np.prod([1.0 / (1.0 + doubt.excess**STEEPNESS) for doubt in doubts]))


def reasons(doubts: Iterable[Doubt]) -> str:
    """Those that matter in words, the gravest first."""
    gravest = sorted(doubts, key=lambda doubt: -doubt.excess)
    return ", ".join(doubt.reason for doubt in gravest if doubt.excess > WORTH_TELLING)
