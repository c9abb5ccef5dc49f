"""Two spheres that moved together since the scan, as the residuals of an adjustment show them.

A clamp or a drape can displace two spheres alike. The residual grows by little, and errors of the arm larger
than stated explain most of it. The test therefore asks for this alone, see `displaced_spheres`; its factor is
a mean over all pairs.

Nothing is corrected: what the likely displacements do to a target is added to its predicted error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from procedures.registration.arm_adjustment import PlannedAdjustment
from procedures.registration.displaced_spheres import Displacements, DisplacementTest
from ronna_hw.arrays import Array

DISPLACED_MM = 0.5  # per axis, one standard deviation of a displacement in common (U)
# Bayes factor beyond which the limit is widened: a larger one leaves more displacements unnoticed.
# Safety against two spheres that moved together. Source: simulated arms.
LEAST_FACTOR = 100.0


@dataclass(frozen=True, eq=False)
class DisplacedPairs:
    """Evidence, by residuals of `a` arms, that the two spheres of each of `p` pairs moved alike."""

    displaced: Displacements

    @property
    def log_factor(self) -> Array:
        """Logarithm (a,) of the Bayes factor that any pair was displaced."""
        factors = self.displaced.log_factors
        return np.asarray(logsumexp(factors, axis=1) - np.log(factors.shape[1]))

    @property
    def is_likely(self) -> NDArray[np.bool_]:
        """Mark the arms (a,) whose residuals show a displaced pair."""
        return np.asarray(self.log_factor > np.log(LEAST_FACTOR))

    @property
    def most_likely(self) -> NDArray[np.intp]:
        """Number (a,) of the most likely pair."""
        return np.asarray(self.displaced.log_factors.argmax(axis=1))

    @property
    def shares(self) -> Array:
        """Probability (a, p) of each pair, if one was displaced."""
        factors = self.displaced.log_factors
        return np.asarray(np.exp(factors - logsumexp(factors, axis=1, keepdims=True)))

    def at_target(self, influences: Array) -> Array:
        """Return the mean square (a, 3, 3) mm2 of a target's shift, if a pair was displaced.

        `influences` (a, p, 3, 3) are those of a displacement of each pair on the target.
        """
        shifts = influences @ self.displaced.moments_mm2 @ np.swapaxes(influences, -1, -2)
        return np.asarray((self.shares[..., None, None] * shifts).sum(axis=1))


@dataclass(frozen=True, eq=False)
class PairTest:
    """Test of every pair of spheres, before any residuals."""

    displacements: DisplacementTest

    @classmethod
    def of(cls, planned: PlannedAdjustment, rows: Sequence[Sequence[int]]) -> Self:
        """Prepare the test of looks; `rows` are those at each sphere."""
        pairs = tuple(combinations(range(len(rows)), 2))
        return cls(DisplacementTest.of(planned.weights, rows, pairs, DISPLACED_MM))

    @property
    def pairs(self) -> tuple[tuple[int, ...], ...]:
        """Pairs (p,) as places in the list of spheres."""
        return self.displacements.groups

    @property
    def columns(self) -> Array:
        """Looks (p, 3m, 3) displaced by each pair."""
        return self.displacements.columns

    def judge(self, residuals_mm: Array, probabilities: Array) -> DisplacedPairs:
        """Judge residuals (a, 3m) of arms whose hypotheses have these probabilities (a, h)."""
        return DisplacedPairs(self.displacements.judge(residuals_mm, probabilities))

    def influences(self, influence: Array) -> Array:
        """Return the influences (a, p, 3, 3) of the pairs' displacements, by that (a, 3, 3m) of the looks."""
        return self.displacements.influences(influence)


@dataclass(frozen=True, eq=False)
class MovedTogether:
    """Two spheres of one case that its residuals show as moved, named as a source of error."""

    source: str
    test: PairTest
    displaced: DisplacedPairs  # of this case alone

    @classmethod
    def find(
        cls,
        planned: PlannedAdjustment,
        residuals_mm: Array,
        probabilities: Array,
        rows: Mapping[str, Sequence[int]],
    ) -> Self | None:
        """Find two spheres that likely moved, by the residuals (3m,) of a case and the looks at each."""
        test, names = PairTest.of(planned, list(rows.values())), list(rows)
        displaced = test.judge(residuals_mm[None], probabilities[None])
        if not displaced.is_likely[0]:
            return None
        one, other = test.pairs[int(displaced.most_likely[0])]
        return cls(f"spheres {names[one]} and {names[other]} moved together", test, displaced)

    def at_target(self, influence: Array) -> Array:
        """Return the mean square (3, 3) mm2 of a target's shift, by the influence (3, 3m) of the looks."""
        return np.asarray(self.displaced.at_target(self.test.influences(influence[None]))[0])
