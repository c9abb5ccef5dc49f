"""Outcomes of the runs of the correspondence study, in the thesis' terms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from studies.campaign.bounds import Bounded, percent
from studies.campaign.unit import Sums
from studies.correspondence.study import FALSE, LOST, PART, condition_of
from studies.heads import NoiseReading

Range = tuple[float, float]


@dataclass(frozen=True)
class Series:
    """Identifies results: noise model, method, e as text (empty for ours), number of fiducials."""

    noise: NoiseReading
    method: str
    tolerance: str
    fiducials: int

    @property
    def tolerance_mm(self) -> float | None:
        """The method's e."""
        return float(self.tolerance) if self.tolerance else None


@dataclass(frozen=True)
class Shares:
    """Per cent of the runs: all, and the range over the numbers of outliers, as in the thesis.

    `unsuccessful` and `false` as in the thesis: a subset of the true pairs is unsuccessful.
    """

    runs: int
    unsuccessful: float
    unsuccessful_range: Range
    false: float
    false_range: Range
    part: float

    @property
    def lost(self) -> float:
        """No answer at all."""
        return self.unsuccessful - self.part

    def bounded(self, share: float) -> Bounded:
        """A share of the runs, per cent, with its bounds."""
        return percent(share / 100.0 * self.runs, self.runs)


def shares(sums: Mapping[str, Sums]) -> dict[Series, Shares]:
    """Outcomes of the runs of each series, over patients."""
    counted: dict[Series, dict[int, dict[str, float]]] = {}
    for condition, content in sums.items():
        noise, _, fiducials, outliers = condition_of(condition)
        for key, number in content.items():
            method, tolerance, outcome = key.split("|")
            conditions = counted.setdefault(Series(noise, method, tolerance, fiducials), {})
            into = conditions.setdefault(outliers, {})
            into[outcome] = into.get(outcome, 0.0) + number
    ordered = sorted(counted.items(), key=lambda item: (item[0].method, item[0].tolerance, item[0].fiducials))
    return {series: _shares(list(conditions.values())) for series, conditions in ordered}


def _shares(conditions: list[dict[str, float]]) -> Shares:
    def share(outcomes: Iterable[str], of: Iterable[Mapping[str, float]]) -> float:
        of, outcomes = list(of), set(outcomes)
        runs = sum(sum(condition.values()) for condition in of)
        return (
            100.0
            * sum(n for condition in of for outcome, n in condition.items() if outcome in outcomes)
            / runs
        )

    unsuccessful = [share((LOST, PART), [condition]) for condition in conditions]
    false = [share((FALSE,), [condition]) for condition in conditions]
    return Shares(
        int(sum(sum(condition.values()) for condition in conditions)),
        share((LOST, PART), conditions),
        (min(unsuccessful), max(unsuccessful)),
        share((FALSE,), conditions),
        (min(false), max(false)),
        share((PART,), conditions),
    )
