"""How much metal streaks bend the background of a ball, estimated from the image itself.

Terms up to the third degree are shrunk towards 0 as strongly as the image permits (empirical Bayes, a ridge):
without streaks they cost no accuracy, with them they remove most of the error. The error hidden in terms
beyond the third degree is included: they are assumed to be as large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.sphere_centre.ball_model import SLOPE, polynomial
from procedures.imaging.sphere_centre.robust_fit import products

Array = NDArray[np.float64]

FITTED_DEGREES = (1, 2, 3)
HIDDEN_DEGREES = (5,)  # even terms do not move the centre of a ball
HIDDEN_SHARE = 1.2  # of the bend terms' size; from tuning families and synthetic bands and lobes on `plain`
LEAST_SLOPE = 2.0  # of the bend terms' size: streaks fade with distance, and slope more than they bend
LEAST_VARIANCE_HU2 = 1e-3  # stands for no streaks
BENT = slice(SLOPE.stop, None)  # the parameters of the second and third degree


@dataclass(frozen=True)
class StreakPrior:
    """Typical size of the background terms, HU² at a radius from the centre.

    The terms are shrunk according to `bent_hu2` and `slope_hu2` (None: not known yet); the true bend may be
    larger by `unsure_hu2`, the standard error of the estimate.
    """

    bent_hu2: float
    unsure_hu2: float
    slope_hu2: float | None = None

    @classmethod
    def of_bends(cls, found: Array, covariance: Array) -> Self:
        """From bend terms (k,) found with a noise `covariance`.

        The moment estimate: with covariance V + v·1, the square over V is k + v·tr V⁻¹ on average,
        and scatters by √(2 k).
        """
        square, trace = _square_over(found, covariance)
        return cls(max(0.0, square - len(found)) / trace, float(np.sqrt(2.0 * len(found))) / trace)

    def with_slopes(self, found: Array, covariance: Array) -> StreakPrior:
        """With the size of slopes (3,), found likewise. Their noise is kept: so few can be 0 by chance."""
        square, trace = _square_over(found, covariance)
        return replace(self, slope_hu2=max(square / trace, LEAST_SLOPE**2 * self.bent_hu2))

    @property
    def streak_hu(self) -> float:
        """Typical size of a bend term, a radius from the centre."""
        return float(np.sqrt(self.bent_hu2))

    def stiffness(self, unknowns: int) -> Array:
        """Strength with which each parameter is shrunk towards 0: 1 over its variance, HU⁻²."""
        drawn = np.zeros(unknowns)
        drawn[BENT] = 1.0 / max(self.bent_hu2, LEAST_VARIANCE_HU2)
        if self.slope_hu2 is not None:
            drawn[SLOPE] = 1.0 / max(self.slope_hu2, LEAST_VARIANCE_HU2)
        return drawn

    def covariance_mm2(self, answer: Array, influence: Array, weights: Array, places: Array) -> Array:
        """Remaining effect of streaks on the centre, (3, 3): through shrunk terms and through higher ones.

        `answer` (m, m) is the response of the parameters to the normal equations, `influence` (n, 3) that of
        the centre to each voxel; `places` (n, 3) are in radii from the centre.
        """
        bent_hu2 = self.bent_hu2 + self.unsure_hu2
        sizes_hu2 = np.zeros(len(answer))
        sizes_hu2[BENT] = bent_hu2
        sizes_hu2[SLOPE] = self.slope_hu2 or 0.0
        drawn = answer[:3] * (self.stiffness(len(answer)) * np.sqrt(sizes_hu2))
        beyond = products(influence, weights[:, None] * polynomial(places, HIDDEN_DEGREES))
        return np.asarray(drawn @ drawn.T + HIDDEN_SHARE**2 * bent_hu2 * (beyond @ beyond.T))


def _square_over(found: Array, covariance: Array) -> tuple[float, float]:
    """The square of `found` over its covariance, and the trace of that covariance's inverse."""
    precision = np.linalg.pinv(covariance, hermitian=True)
    return float(found @ precision @ found), float(np.trace(precision))
