"""Spheres displaced since the scan: what residuals of an adjustment say for it, and against it.

Groups of spheres share a displacement each, unknown but of a stated size, under every hypothesis about the
arm. The likelihood of the residuals with it against that without is a Bayes factor (Kass and Raftery 1995,
Bayes factors, J. Am. Stat. Assoc. 90). With right errors its mean is one: by Markov's inequality it is beyond
a factor in one case of that many at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import logsumexp

from procedures.registration.target_prediction import AXES
from ronna_hw.arrays import Array

Group = tuple[int, ...]  # places in the list of spheres


@dataclass(frozen=True, eq=False)
class DisplacementTest:
    """Test of `g` groups of spheres under `h` hypotheses, before any residuals."""

    groups: tuple[Group, ...]
    columns: Array  # (g, 3m, 3) looks displaced by each group
    seen: Array  # (g, h, 3m, 3) information of the looks about the displacement
    covariances_mm2: Array  # (g, h, 3, 3) of the displacement after the looks
    spreads: Array  # (g, h) log determinants of what the looks leave of its variance

    @classmethod
    def of(
        cls,
        weights: Array,
        rows: Sequence[Sequence[int]],
        groups: Sequence[Group],
        displaced_mm: float,
    ) -> Self:
        """Prepare the test of looks, weighted (h, 3m, 3m) with what a pose explains excluded.

        `rows` are those at each sphere, `displaced_mm` is one standard deviation of a displacement per axis.
        """
        looks = weights.shape[-1] // AXES
        columns = np.zeros((len(groups), looks, AXES, AXES))
        for number, group in enumerate(groups):
            columns[number, [row for one in group for row in rows[one]]] = np.eye(AXES)
        flat = columns.reshape(len(groups), -1, AXES)
        seen = weights @ flat[:, None]
        known = np.swapaxes(flat, 1, 2)[:, None] @ seen + np.eye(AXES) / displaced_mm**2
        spreads: Array = np.linalg.slogdet(known)[1] + 2.0 * AXES * np.log(displaced_mm)
        return cls(tuple(groups), flat, seen, np.asarray(np.linalg.inv(known), dtype=np.float64), spreads)

    def judge(self, residuals_mm: Array, probabilities: Array) -> Displacements:
        """Judge residuals (a, 3m) of arms whose hypotheses have these probabilities (a, h)."""
        seen = self.seen.transpose(2, 0, 1, 3)
        told = (residuals_mm @ seen.reshape(len(seen), -1)).reshape(len(residuals_mm), *seen.shape[1:])
        found = np.einsum("phij,aphj->aphi", self.covariances_mm2, told)
        with np.errstate(divide="ignore"):  # a hypothesis of no probability
            log = np.log(probabilities)[:, None]
        log = log + 0.5 * (np.einsum("aphi,aphi->aph", told, found) - self.spreads)
        return Displacements(self, logsumexp(log, axis=2), log, found)

    def influences(self, influence: Array) -> Array:
        """Return the influences (a, g, 3, 3) of the displacements, by that (a, 3, 3m) of the looks."""
        return np.asarray(influence[:, None] @ self.columns)


@dataclass(frozen=True, eq=False)
class Displacements:
    """Judged displacements of each group by the residuals of `a` arms."""

    test: DisplacementTest
    log_factors: Array  # (a, g) of the likelihoods with it and without
    log_hypotheses: Array  # (a, g, h) the same for each hypothesis, times its probability
    expected_mm: Array  # (a, g, h, 3) displacement, should there be one

    @property
    def moments_mm2(self) -> Array:
        """Mean square (a, g, 3, 3) of each displacement, should there be one."""
        odds = np.exp(self.log_hypotheses - self.log_factors[..., None])
        moments = np.einsum("aph,aphi,aphj->apij", odds, self.expected_mm, self.expected_mm)
        return np.asarray(moments + np.einsum("aph,phij->apij", odds, self.test.covariances_mm2))
