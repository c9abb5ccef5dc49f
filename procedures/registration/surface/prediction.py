"""Error of a registration at a target, as a mixture over the hypotheses about the misfit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr

from procedures.registration.error_theory import DEFAULT_CONFIDENCE
from ronna_hw.arrays import Array

LIMIT_STEPS = 32  # bisections: the limit is then exact to a millionth of a millimetre
FARTHEST_LIMIT = 20.0  # of the largest rms: no mixture has its 95 % limit beyond


@dataclass(frozen=True, eq=False)
class SurfacePrediction:
    """Error of the registration at one target, in the robot or CT frame: a mixture of normal errors.

    Of each hypothesis (h,) the offset (h, 3) from the pose that is used, and the covariance (h, 3, 3).
    """

    weights: Array
    offsets_mm: Array
    covariances_mm2: Array

    @property
    def covariance_mm2(self) -> Array:
        """Covariance (3, 3) of the error."""
        spread = self.offsets_mm[:, :, None] * self.offsets_mm[:, None, :]
        return np.asarray(np.einsum("h,hij->ij", self.weights, self.covariances_mm2 + spread))

    @property
    def rms_mm(self) -> float:
        """Rms magnitude of the error."""
        return float(np.sqrt(np.trace(self.covariance_mm2)))

    def draw_mm(self, random: np.random.Generator) -> Array:
        """Draw an error (3,), as it comes if the prediction is right."""
        row = int(random.choice(len(self.weights), p=self.weights / self.weights.sum()))
        return np.asarray(random.multivariate_normal(self.offsets_mm[row], self.covariances_mm2[row]))

    def limit_mm(self, confidence: float = DEFAULT_CONFIDENCE) -> float:
        """Return the radius in mm that contains the error with this probability."""
        return mixture_limit_mm(self.weights, self.offsets_mm, self.covariances_mm2, confidence)


def mixture_limit_mm(weights: Array, offsets_mm: Array, covariances_mm2: Array, confidence: float) -> float:
    """Return the radius in mm that contains an error drawn from a mixture with this probability.

    Of each part (h,) the error is normal with an offset (h, 3) and a covariance (h, 3, 3); its squared length
    is taken as a scaled chi-square with its mean and variance (Patnaik 1949, as `offset_limit_mm`).
    """
    mean = np.sum(offsets_mm**2, axis=1) + np.trace(covariances_mm2, axis1=1, axis2=2)
    cross = np.einsum("hi,hij,hj->h", offsets_mm, covariances_mm2, offsets_mm)
    variance = 2.0 * np.sum(covariances_mm2**2, axis=(1, 2)) + 4.0 * cross
    freedom, scale = 2.0 * mean**2 / variance, variance / (2.0 * mean)
    low, high = 0.0, FARTHEST_LIMIT * float(np.sqrt(mean.max()))
    for _ in range(LIMIT_STEPS):
        middle = 0.5 * (low + high)
        within = float(weights @ chdtr(freedom, middle**2 / scale))
        low, high = (middle, high) if within < confidence else (low, middle)
    return high
