"""Tables of `learning` against the other strategies, all numbers of spheres together and each alone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import wilcoxon

from studies.accuracy.phantom import Markers, counts_of
from studies.campaign.study import Cell, Sums, Table
from studies.strategies.case_plans import LEARNING, LOOK_S, STRATEGIES
from studies.strategies.learning import (
    ARM_EFFECTS,
    EFFECTS,
    ERROR,
    GAUGE,
    PASSED_OVER,
    REFUSAL,
    RESIDUAL,
    SCENARIOS,
    SHARES,
    SIZES,
    SUSPECT,
    TARGETS_OF_CASE,
)

COUNTS = counts_of(Markers.FREE)
ALL = "all"
Trial = tuple[int, str, str]  # spheres, place and case, target


@dataclass
class Series:
    """Results of one strategy on arms of one kind: errors by trial, and sums of the rest."""

    errors_mm: dict[Trial, float] = field(default_factory=dict)
    sums: dict[str, float] = field(default_factory=lambda: defaultdict(float))

    def row(self) -> dict[str, Cell]:
        """Return its figures; none of the errors where every trial was refused."""
        cases, used = self.sums["cases"], self.sums["used"]
        trials, errors = cases * TARGETS_OF_CASE, np.array(list(self.errors_mm.values()))
        return {
            "targets": round(trials),
            "refused by residual %": 100.0 * self.sums[RESIDUAL] / trials,
            "refused for moved sphere or bad arm %": 100.0 * self.sums[SUSPECT] / trials,
            "refused by gauge %": 100.0 * self.sums[GAUGE] / trials,
            "mean mm": float(errors.mean()) if used else None,
            "99 % below mm": float(np.quantile(errors, 0.99)) if used else None,
            "largest mm": float(errors.max()) if used else None,
            "within 95 % limit %": 100.0 * self.sums["inside"] / used if used else None,
            "mean limit mm": self.sums["limit"] / used if used else None,
            "looks": self.sums["looks"] / cases,
            "theatre s": self.sums["seconds"] / cases,
        }


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate every strategy, `learning` paired with each, and both on arms with unmodelled effects."""
    series = _collect(sums)
    passed_over = sum(one.get(PASSED_OVER, 0.0) for one in sums.values()) / len(SCENARIOS)
    shares = [f"{share:g}" for share in SHARES]
    return [
        Table.of(
            "Strategies on the same cases",
            [
                _head(kind, share, strategy, count) | series[kind, SIZES, share, strategy, count].row()
                for kind in SCENARIOS
                for share in shares
                for count in (ALL, *map(str, COUNTS))
                for strategy in STRATEGIES
            ],
            f"Size: of the arm's errors, by those stated. Theatre seconds: moves and {LOOK_S:g} s a look, "
            f"with all looks of a case of {TARGETS_OF_CASE} targets. Refused by residual: beyond its "
            f"{100 * REFUSAL:g} % limit. For moved sphere or bad arm, of `learning`: a sphere that has more "
            "probably moved than not, or errors or a correction beyond their limit. "
            f"{passed_over:g} trajectories that a strategy does not reach were "
            "passed over.",
        ),
        Table.of(
            "Learning and each other strategy, by target",
            [
                _head(kind, share, other, count)
                | _compare(
                    series[kind, SIZES, share, LEARNING, count], series[kind, SIZES, share, other, count]
                )
                for kind in SCENARIOS
                for share in shares
                for count in (ALL, *map(str, COUNTS))
                for other in STRATEGIES
                if other != LEARNING
            ],
            "Error of `learning` less that of the strategy, where both were used. p: Wilcoxon signed-rank "
            "test, two-sided, of the targets and of the means of the cases.",
        ),
        Table.of(
            "Arms with effects that the model lacks, by strategy",
            [
                {"arm": kind, "effect": effect, "strategy": strategy}
                | series[kind, EFFECTS, effect, strategy, ALL].row()
                | _compare(
                    series[kind, EFFECTS, effect, strategy, ALL], series[kind, EFFECTS, effect, "ocs", ALL]
                )
                for kind in SCENARIOS
                for effect in ARM_EFFECTS
                for strategy in STRATEGIES
            ],
            "3, 4 and 5 spheres together. Difference: to `ocs`, where both were used.",
        ),
    ]


def _head(kind: str, share: str, strategy: str, count: str) -> dict[str, Cell]:
    return {"arm": kind, "size": share, "spheres": count, "strategy": strategy}


def _compare(mine: Series, other: Series) -> dict[str, Cell]:
    """Compare two strategies by target, and by the mean of each case and number of spheres."""
    both = [trial for trial in mine.errors_mm if trial in other.errors_mm]
    apart = [mine.errors_mm[one] - other.errors_mm[one] for one in both]
    by_case: dict[str, list[float]] = defaultdict(list)
    for (_, case, _), one in zip(both, apart, strict=True):
        by_case[case].append(one)
    of_cases = [float(np.mean(one)) for one in by_case.values()]
    return {
        "paired targets": len(both),
        "difference mm": float(np.mean(apart)) if both else None,
        "better at %": 100.0 * float(np.mean(np.array(apart) < 0.0)) if both else None,
        "p by target": _p(apart),
        "p by case": _p(of_cases),
    }


def _p(apart_mm: Sequence[float]) -> str | None:
    return f"{float(wilcoxon(apart_mm).pvalue):.1e}" if np.any(apart_mm) else None


def _collect(sums: Mapping[str, Sums]) -> dict[tuple[str, str, str, str, str], Series]:
    """Collect the series by arm, part, share or effect, strategy and number of spheres."""
    found: dict[tuple[str, str, str, str, str], Series] = defaultdict(Series)
    for condition, content in sums.items():
        kind, place = condition.split("|")
        for key, value in content.items():
            if key == PASSED_OVER:
                continue
            part, what, strategy, count, quantity = key.split("|")
            for spheres in (count, ALL):
                series = found[kind, part, what, strategy, spheres]
                if quantity.startswith(ERROR):
                    case, _, target = quantity.removeprefix(ERROR).partition(".")
                    series.errors_mm[int(count), f"{place} {case}", target] = value
                else:
                    series.sums[quantity] += value
    return found
