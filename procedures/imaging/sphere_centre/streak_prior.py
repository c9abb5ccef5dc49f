"""Size of the streaks that bend a ball's background, and what they cost a fitted parameter.

Bend terms and slopes are shrunk towards 0 as strongly as the image permits (empirical Bayes, a ridge):
without streaks they cost no accuracy, with them they remove most of the error. Terms beyond the third degree
are assumed to be as large, and their error is included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import comb
from typing import Self

import numpy as np

from procedures.imaging.sphere_centre.ball_model import FITTED_DEGREES, SLOPE, polynomial, products
from ronna_hw.arrays import Array

HIDDEN_SHARE = 1.2  # of the bend terms' size; from tuning families and synthetic bands and lobes on `plain`
LEAST_SLOPE = 2.0  # of the bend terms' size: streaks fade with distance, and slope more than they bend
LEAST_VARIANCE_HU2 = 1e-3  # stands for no streaks
BENDS = sum(comb(degree + 2, 2) for degree in FITTED_DEGREES if degree > 1)
BENT = slice(SLOPE.stop, SLOPE.stop + BENDS)  # the parameters of the second and third degree


@dataclass(frozen=True)
class StreakPrior:
    """Typical variance of the background terms at one radius from the centre, HU².

    The terms are shrunk according to `bent_hu2` and `slope_hu2` (None: not known yet); the true bend may be
    larger by `uncertainty_hu2`, the standard error of the estimate.
    """

    bent_hu2: float
    uncertainty_hu2: float
    slope_hu2: float | None = None

    @classmethod
    def from_bends(cls, found: Array, covariance: Array) -> Self:
        """Estimate the variance from bend terms (k,) that have this noise `covariance`.

        The moment estimate: with covariance V + v·1, the square over V is k + v·tr V⁻¹ on average, and
        scatters by √(2 k).
        """
        square, trace = _mahalanobis_square(found, covariance)
        return cls(max(0.0, square - len(found)) / trace, float(np.sqrt(2.0 * len(found))) / trace)

    def with_slopes(self, found: Array, covariance: Array) -> StreakPrior:
        """Add the variance of the slopes (3,), including noise, since three terms can be 0 by chance."""
        square, trace = _mahalanobis_square(found, covariance)
        return replace(self, slope_hu2=max(square / trace, LEAST_SLOPE**2 * self.bent_hu2))

    @property
    def streak_hu(self) -> float:
        """Typical bend term at one radius from the centre."""
        return float(np.sqrt(self.bent_hu2))

    def stiffness(self, unknowns: int) -> Array:
        """Return the shrinkage of each parameter towards 0, as inverse variance in HU⁻²."""
        shrinkage = np.zeros(unknowns)
        shrinkage[BENT] = 1.0 / max(self.bent_hu2, LEAST_VARIANCE_HU2)
        if self.slope_hu2 is not None:
            shrinkage[SLOPE] = 1.0 / max(self.slope_hu2, LEAST_VARIANCE_HU2)
        return shrinkage

    def covariance_mm2(
        self, answer: Array, influence: Array, weights: Array, places: Array, hidden_degrees: tuple[int, ...]
    ) -> Array:
        """Return the covariance (k, k) of k parameters due to streaks, through shrunk and unmodelled terms.

        `answer` (k, m) is their response to the normal equations, `influence` (n, k) to each voxel; `places`
        (n, 3) are in radii from the centre. Unmodelled are the terms of `hidden_degrees`.
        """
        bent_hu2 = self.bent_hu2 + self.uncertainty_hu2
        unknowns = answer.shape[1]
        sizes_hu2 = np.zeros(unknowns)
        sizes_hu2[BENT] = bent_hu2
        sizes_hu2[SLOPE] = self.slope_hu2 or 0.0
        shrinkage = answer * (self.stiffness(unknowns) * np.sqrt(sizes_hu2))
        higher_terms = products(influence, weights[:, None] * polynomial(places, hidden_degrees))
        return np.asarray(
            shrinkage @ shrinkage.T + HIDDEN_SHARE**2 * bent_hu2 * (higher_terms @ higher_terms.T)
        )


def _mahalanobis_square(found: Array, covariance: Array) -> tuple[float, float]:
    """Return the squared Mahalanobis norm of `found`, and the trace of the inverse covariance."""
    precision = np.linalg.pinv(covariance, hermitian=True)
    return float(found @ precision @ found), float(np.trace(precision))
