"""What a measurement hands on: figures, each beside a baseline of the same run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import Self


@dataclass(frozen=True)
class Figure:
    """One number. `ratio` is the value over the baseline's, both from the same rounds.

    `goal` says in words what was to be reached; `met` is None where there is no goal.
    """

    what: str
    who: str
    value: float
    unit: str
    ratio: float | None = None
    baseline: str = ""
    more: dict[str, float] = field(default_factory=dict)  # into the JSON only, such as p99
    goal: str = ""
    met: bool | None = None

    def with_goal(self, *, at_least: float | None = None, at_least_ratio: float | None = None) -> Self:
        """The same figure held against a limit for its value or for its ratio."""
        if at_least is not None:
            return replace(self, goal=f"value ≥ {at_least:,.0f}", met=self.value >= at_least)
        if at_least_ratio is None or self.ratio is None:
            raise ValueError("a goal needs a limit, and one for a ratio a baseline")
        met = self.ratio >= at_least_ratio
        return replace(self, goal=f"ratio ≥ {at_least_ratio:.3g}", met=met)


def compared(
    what: str, unit: str, samples: Mapping[str, Sequence[float]], baseline: str, *, scale: float = 1.0
) -> list[Figure]:
    """Medians of the contestants' samples, and the median of the ratios round by round.

    A machine that stalls does so for everybody in the round: ratios within a round keep what medians over
    the run lose.
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
