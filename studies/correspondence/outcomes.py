"""Outcome of a pairing, and the numbers of runs by outcome.

A run is successful if exactly the true pairs are returned. It is false with a wrong pair, partial if the
pairs are right but incomplete, and otherwise lost. The thesis counts a partial result as unsuccessful
(success is exact count and exact order), our goals count it as false.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from procedures.registration.correspondence import Match, MatchStatus
from procedures.registration.similarity_matrix import SimilarityPairs
from studies.campaign.bounds import Bounded, percent
from studies.campaign.study import Sums

SUCCESS, LOST, PART, FALSE = "success", "lost", "part", "false"
OUTCOMES = (SUCCESS, LOST, PART, FALSE)
UNSUCCESSFUL = (LOST, PART)  # in the thesis' terms
Pairs = frozenset[tuple[int, int]]
Range = tuple[float, float]
Series = TypeVar("Series", bound=Hashable)


def pair_set(pairs: NDArray[np.intp]) -> Pairs:
    return frozenset((i, j) for i, j in pairs.tolist())


def outcome_of(found: Match | SimilarityPairs, right: Pairs) -> str:
    return verdict(found.pairs, right) if found.status is MatchStatus.UNIQUE else LOST


def verdict(pairs: NDArray[np.intp], right: Pairs) -> str:
    found_pairs = pair_set(pairs)
    if found_pairs == right:
        return SUCCESS
    return PART if found_pairs < right else FALSE


def outcome_key(method: str, tolerance_mm: float | None, outcome: str) -> str:
    return f"{method}|{'' if tolerance_mm is None else tolerance_mm}|{outcome}"


class Outcomes(dict[int, Counter[str]]):
    """Numbers of runs by outcome, in cells by number of outliers."""

    @property
    def runs(self) -> int:
        return sum(cell.total() for cell in self.values())

    def count(self, *outcomes: str) -> int:
        """Return the number of runs with any of the outcomes, over all cells."""
        return sum(cell[one] for cell in self.values() for one in outcomes)

    def percent(self, *outcomes: str) -> Bounded:
        return percent(self.count(*outcomes), self.runs)

    def percent_by_outliers(self, *outcomes: str) -> list[float]:
        """Return the percentage of each cell, the one with fewest outliers first."""
        cells = [self[outliers] for outliers in sorted(self)]
        return [100.0 * sum(cell[one] for one in outcomes) / cell.total() for cell in cells]

    def range_percent(self, *outcomes: str) -> Range:
        """Return the smallest and largest percentage of any cell."""
        shares = self.percent_by_outliers(*outcomes)
        return min(shares), max(shares)


def count_outcomes(
    sums: Mapping[str, Sums], series_of: Callable[[str, str], Series | None]
) -> dict[Series, Outcomes]:
    """Count by series, which `series_of` returns for a condition and a method; None is left out.

    A condition ends in its number of outliers, the key of a sum in its outcome.
    """
    counted: dict[Series, Outcomes] = {}
    for condition, content in sums.items():
        outliers = int(condition.rpartition("|")[2])
        for key, number in content.items():
            method, _, outcome = key.rpartition("|")
            if (series := series_of(condition, method)) is not None:
                cells = counted.setdefault(series, Outcomes())
                cells.setdefault(outliers, Counter())[outcome] += round(number)
    return counted
