"""Two spheres that moved together since the scan, as the residuals of an adjustment show them.

A clamp or a drape can displace two spheres alike. The residual grows by little, and errors of the arm larger
than stated explain most of it. The test therefore asks for this alone: for each pair of spheres a
displacement in common, unknown but of a stated size, under every hypothesis about the arm. The likelihood
with it, as a mean over all pairs, against the likelihood without is a Bayes factor (Kass and Raftery 1995,
Bayes factors, J. Am. Stat. Assoc. 90). With right errors it is beyond `LEAST_FACTOR` in one case of that many
at most, by Markov's inequality.

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
from procedures.registration.target_prediction import AXES
from ronna_hw.arrays import Array

DISPLACED_MM = 0.5  # per axis, one standard deviation of a displacement in common (U)
# Bayes factor beyond which the limit is widened: a larger one leaves more displacements unnoticed.
# Safety against two spheres that moved together. Source: simulated arms.
LEAST_FACTOR = 100.0


@dataclass(frozen=True, eq=False)
class DisplacedPairs:
    """What residuals of `a` arms say of a displacement that the two spheres of each of `p` pairs share."""

    log_factors: Array  # (a, p) of the likelihoods with it and without
    moments_mm2: Array  # (a, p, 3, 3) mean square of the displacement, should there be one

    @property
    def log_factor(self) -> Array:
        """Logarithm (a,) of the Bayes factor that any pair was displaced."""
        return np.asarray(logsumexp(self.log_factors, axis=1) - np.log(self.log_factors.shape[1]))

    @property
    def is_likely(self) -> Array:
        """Mark the arms (a,) whose residuals show a displaced pair."""
        return np.asarray(self.log_factor > np.log(LEAST_FACTOR))

    @property
    def most_likely(self) -> NDArray[np.intp]:
        """Number (a,) of the most likely pair."""
        return np.asarray(self.log_factors.argmax(axis=1))

    @property
    def shares(self) -> Array:
        """Probability (a, p) of each pair, if one was displaced."""
        return np.asarray(np.exp(self.log_factors - logsumexp(self.log_factors, axis=1, keepdims=True)))

    def at_target(self, influences: Array) -> Array:
        """Return the mean square (a, 3, 3) mm2 of a target's shift, if a pair was displaced.

        `influences` (a, p, 3, 3) are those of a displacement of each pair on the target.
        """
        shifts = influences @ self.moments_mm2 @ np.swapaxes(influences, -1, -2)
        return np.asarray((self.shares[..., None, None] * shifts).sum(axis=1))


@dataclass(frozen=True, eq=False)
class PairTest:
    """Test of every pair of spheres under every hypothesis, before any residuals."""

    pairs: tuple[tuple[int, int], ...]  # (p,) places in the list of spheres
    columns: Array  # (p, 3m, 3) looks displaced by each pair
    seen: Array  # (p, h, 3m, 3) information of the looks about the displacement
    covariances_mm2: Array  # (p, h, 3, 3) of the displacement after the looks
    spreads: Array  # (p, h) log determinants of what the looks leave of its variance

    @classmethod
    def of(cls, planned: PlannedAdjustment, rows: Sequence[Sequence[int]]) -> Self:
        """Prepare the test of looks; `rows` are those at each sphere."""
        pairs = tuple(combinations(range(len(rows)), 2))
        looks = planned.weights.shape[-1] // AXES
        columns = np.zeros((len(pairs), looks, AXES, AXES))
        for number, (one, other) in enumerate(pairs):
            columns[number, [*rows[one], *rows[other]]] = np.eye(AXES)
        flat = columns.reshape(len(pairs), -1, AXES)
        seen = planned.weights @ flat[:, None]
        known = np.swapaxes(flat, 1, 2)[:, None] @ seen + np.eye(AXES) / DISPLACED_MM**2
        spreads: Array = np.linalg.slogdet(known)[1] + 2.0 * AXES * np.log(DISPLACED_MM)
        return cls(pairs, flat, seen, np.asarray(np.linalg.inv(known), dtype=np.float64), spreads)

    def judge(self, residuals_mm: Array, probabilities: Array) -> DisplacedPairs:
        """Judge residuals (a, 3m) of arms whose hypotheses have these probabilities (a, h)."""
        told = np.einsum("ai,phij->aphj", residuals_mm, self.seen)
        found = np.einsum("phij,aphj->aphi", self.covariances_mm2, told)
        with np.errstate(divide="ignore"):  # a hypothesis of no probability
            log = np.log(probabilities)[:, None]
        log = log + 0.5 * (np.einsum("aphi,aphi->aph", told, found) - self.spreads)
        factors = logsumexp(log, axis=2)
        odds = np.exp(log - factors[..., None])
        moments = np.einsum("aph,aphi,aphj->apij", odds, found, found)
        return DisplacedPairs(factors, moments + np.einsum("aph,phij->apij", odds, self.covariances_mm2))

    def influences(self, influence: Array) -> Array:
        """Return the influences (a, p, 3, 3) of the pairs' displacements, by that (a, 3, 3m) of the looks."""
        return np.asarray(influence[:, None] @ self.columns)


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
