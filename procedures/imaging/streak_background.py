"""How much do streaks of metal bend the background of a ball? The image itself says it.

A slope is always fitted. Terms of the second and third degree are drawn towards 0 as strongly as the image
allows (empirical Bayes, a ridge): without streaks they cost no accuracy, with them they take most of the
error away. What terms beyond the third degree may still hide is stated: they are taken to be as large.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.ball_model import SLOPE, polynomial
from procedures.imaging.noise_covariance import CorrelatedNoise
from procedures.imaging.robust_fit import products

Array = NDArray[np.float64]

FITTED_DEGREES = (1, 2, 3)
HIDDEN_DEGREES = (5,)  # even terms do not move the centre of a ball
HIDDEN_SHARE = 1.2  # of the bent terms' size; from tuning families and synthetic bands and lobes on `plain`
LEAST_VARIANCE_HU2 = 1e-3  # stands for no streaks
BENT = slice(SLOPE.stop, None)  # the unknowns of the second and third degree


@dataclass(frozen=True)
class StreakPrior:
    """The variance of each bent term, in HU² at a radius from the middle, and of slow noise per voxel."""

    variance_hu2: float
    noise_hu2: float

    @classmethod
    def of_free_fit(cls, unknowns: Array, influence: Array, noise: CorrelatedNoise) -> StreakPrior:
        """From a fit whose bent terms were free; `influence` (n, k) is that of the noise on them.

        The moment estimate: of k terms with covariance V + v·1, the expected square over V is k + v·tr V⁻¹.
        """
        bent = unknowns[BENT]
        precision = np.linalg.pinv(noise.slow_variance * products(influence, influence), hermitian=True)
        excess = float(bent @ precision @ bent) - len(bent)
        return cls(max(0.0, excess / float(np.trace(precision))), noise.slow_variance)

    @property
    def streak_hu(self) -> float:
        """Usual size of a bent term, a radius away from the middle."""
        return float(np.sqrt(self.variance_hu2))

    def stiffness(self, unknowns: int) -> Array:
        """By how much each of so many unknowns is drawn towards 0."""
        drawn = np.zeros(unknowns)
        drawn[BENT] = self.noise_hu2 / max(self.variance_hu2, LEAST_VARIANCE_HU2)
        return drawn

    def covariance_mm2(self, inverse: Array, influence: Array, weights: Array, places: Array) -> Array:
        """What streaks may still do to the centre, (3, 3): by drawn terms, and by those beyond them.

        `inverse` (m, m) tells how the unknowns answer to a pull, `influence` (n, 3) how the centre answers
        to one of each voxel; `places` (n, 3) are in radii from the middle.
        """
        drawn = inverse[:3, BENT] * self.stiffness(len(inverse))[BENT]
        beyond = products(influence, weights[:, None] * polynomial(places, HIDDEN_DEGREES))
        return np.asarray(self.variance_hu2 * (drawn @ drawn.T + HIDDEN_SHARE**2 * beyond @ beyond.T))
