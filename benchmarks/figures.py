"""The result of a measurement: figures, each with a baseline from the same run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Self


@dataclass(frozen=True)
class Figure:
    """One number. `ratio` is the value over the baseline's, both from the same rounds.

    `goal` states the goal in words; `met` is None without a goal.
    """

    what: str
    who: str
    value: float
    unit: str
    ratio: float | None = None
    baseline: str = ""
    more: dict[str, float] = field(default_factory=dict)  # only for the JSON output, such as p99
    goal: str = ""
    met: bool | None = None

    def at_least(self, limit: float) -> Self:
        """The same figure with a goal: a minimum."""
        return replace(self, goal=f"value ≥ {limit:,g}", met=self.value >= limit)

    def at_most(self, limit: float) -> Self:
        """The same figure with a goal: a maximum."""
        return replace(self, goal=f"value ≤ {limit:g}", met=self.value <= limit)

    def within(self, low: float, high: float) -> Self:
        """The same figure with a goal: a range of the value."""
        return replace(self, goal=f"{low:g} to {high:g}", met=low <= self.value <= high)

    def ratio_at_least(self, limit: float) -> Self:
        """The same figure with a goal for its ratio; raises ValueError without a baseline."""
        if self.ratio is None:
            raise ValueError("a goal for a ratio needs a baseline")
        return replace(self, goal=f"ratio ≥ {limit:.3g}", met=self.ratio >= limit)


def compared(
    what: str, unit: str, samples: Mapping[str, Sequence[float]], baseline: str, *, scale: float = 1.0
) -> list[Figure]:
    """Medians of the contestants' samples, and the median of the ratios round by round.

    A machine that stalls does so for every contestant in the round: ratios within a round preserve what
    medians over the run lose.
    """
    base = samples[baseline]
    figures = []
    for who, values in samples.items():
        ratio = None
        if who != baseline:
            ratio = median(one / other for one, other in zip(values, base, strict=True) if other)
        figures.append(
            Figure(what, who, median(values) * scale, unit, ratio, baseline if ratio is not None else "")
        )
    return figures
