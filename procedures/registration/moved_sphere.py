"""A sphere that moved since the scan, against an arm that is worse than stated.

Both leave residuals, and an adjustment that weighs sizes of the arm's errors takes either for the other. So
each is given its probability: every sphere displaced alone, and every two alike, against none, under all
hypotheses about the arm (see `displaced_spheres`). With four spheres the looks alone often cannot tell. The
tracker can: it sees the spheres without the arm, and one that moved before its look is displaced in both. One
that moved after it is displaced in the looks alone, so the more telling of both counts: what the tracker saw
in its place speaks for no sphere. The odds before the looks are stated here. Nothing is
corrected or widened: where a displacement is more probable than not, the registration is refused, or the
sphere is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, log_expit, logsumexp

from procedures.registration.arm_adjustment import PlannedAdjustment
from procedures.registration.displaced_spheres import DisplacementTest, Group
from procedures.registration.target_prediction import AXES
from procedures.registration.tracker_view import TrackerView
from ronna_hw.arrays import Array

# Per axis, one standard deviation of a displacement, each as probable: a sphere that was leaned on, and one
# that came loose. (U)
DISPLACED_MM = (0.3, 1.0)
# Odds before the looks that any one sphere has moved, and any two alike. (U)
MOVED_ODDS, MOVED_ALIKE_ODDS = 1.0 / 20.0, 1.0 / 1000.0
# More probable than not.
# Safety against a moved sphere that is taken for an error of the arm (U).
MOST_PROBABLE = 0.5
# Of the probability of any displacement: groups below this share do not count as its cause (U).
LEAST_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class MovedSpheres:
    """Log odds (a, g) that a group of spheres has moved rather than none, by the residuals of `a` arms."""

    groups: tuple[Group, ...]
    log_odds: Array

    @property
    def probability(self) -> Array:
        """Probability (a,) that any group has moved."""
        return np.asarray(expit(logsumexp(self.log_odds, axis=1)))

    @property
    def is_probable(self) -> NDArray[np.bool_]:
        """Mark the arms (a,) whose residuals show moved spheres rather than errors of the arm."""
        return np.asarray(log_expit(logsumexp(self.log_odds, axis=1)) > np.log(MOST_PROBABLE))

    def suspects(self, arm: int = 0) -> tuple[Group, ...]:
        """Return the groups that may have moved, if any has, most probable first."""
        odds = self.log_odds[arm]
        shares = np.exp(odds - logsumexp(odds))
        order = np.argsort(-shares, kind="stable")
        return tuple(self.groups[one] for one in order if shares[one] >= LEAST_SHARE)


@dataclass(frozen=True, eq=False)
class MovedSphereTest:
    """Test of each sphere, and of every two, before any residuals."""

    groups: tuple[Group, ...]
    before: Array  # (g,) log odds
    tests: tuple[DisplacementTest, ...]  # by size of the displacement
    seen: tuple[DisplacementTest, ...]  # the same of one that the tracker saw too, if it looked

    @classmethod
    def of(
        cls, planned: PlannedAdjustment, rows: Sequence[Sequence[int]], view: TrackerView | None = None
    ) -> Self:
        """Prepare the test of looks; `rows` are those at each sphere of the tracker's `view`."""
        alone: list[Group] = [(place,) for place in range(len(rows))]
        alike: list[Group] = list(combinations(range(len(rows)), 2))
        groups = (*alone, *alike)
        before = np.log(
            [*[MOVED_ODDS / len(alone)] * len(alone), *[MOVED_ALIKE_ODDS / len(alike)] * len(alike)]
        )
        tests = _by_size(planned.weights, rows, groups)
        if view is None:
            return cls(groups, before, tests, ())
        looks = planned.weights.shape[-1] // AXES
        of_both = [[*own, looks + place] for place, own in enumerate(rows)]
        return cls(groups, before, tests, _by_size(view.weigh_with(planned, rows), of_both, groups))

    def judge(self, residuals_mm: Array, probabilities: Array, seen_mm: Array | None = None) -> MovedSpheres:
        """Judge residuals (a, 3m) of arms whose hypotheses have these probabilities (a, h).

        `seen_mm` (a, 3n) are those of the tracker's view, if it was prepared with one.
        """
        factors = _log_factors(self.tests, residuals_mm, probabilities)
        if seen_mm is not None:
            both = np.concatenate([residuals_mm, seen_mm], axis=1)
            factors = np.maximum(factors, _log_factors(self.seen, both, probabilities))
        return MovedSpheres(self.groups, self.before + factors)


def _by_size(
    weights: Array, rows: Sequence[Sequence[int]], groups: Sequence[Group]
) -> tuple[DisplacementTest, ...]:
    return tuple(DisplacementTest.of(weights, rows, groups, size_mm) for size_mm in DISPLACED_MM)


def _log_factors(tests: Sequence[DisplacementTest], residuals_mm: Array, probabilities: Array) -> Array:
    """Return the log factors (a, g), means over the sizes of a displacement."""
    factors = [test.judge(residuals_mm, probabilities).log_factors for test in tests]
    return np.asarray(logsumexp(factors, axis=0) - np.log(len(factors)))
