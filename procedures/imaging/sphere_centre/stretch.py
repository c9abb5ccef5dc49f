"""Difference in a body's extent between directions; that of a ball is zero.

A surface at distance R + q(n) along each direction n, with q of second degree and zero mean, is an ellipsoid
to first order. This is the main difference between a short rod with round ends and a ball. Fitted together
with ball and background, it is determined to a few hundredths of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.sphere_centre.ball_model import RADIUS

Array = NDArray[np.float64]

TERMS = 5


@dataclass(frozen=True, eq=False)
class Stretch:
    """How far a body's surface is from a ball's along each direction n: n' terms n, in mm.

    `terms_mm` (3, 3) along slice, row and column; `deviation_mm` is the standard deviation of a term.
    """

    terms_mm: Array
    deviation_mm: float

    @classmethod
    def of_last_terms(cls, found: Array, covariance: Array) -> Self:
        """From the parameters of a stretched ball and their covariance."""
        a, b, c, d, e = found[-TERMS:].tolist()
        matrix = np.array([[a, c / 2, d / 2], [c / 2, b, e / 2], [d / 2, e / 2, -a - b]])
        variance = float(np.trace(covariance[-TERMS:, -TERMS:])) / TERMS
        return cls(matrix, float(np.sqrt(variance)))

    @property
    def difference_mm(self) -> float:
        """Longest minus shortest semi-axis."""
        return float(np.ptp(np.linalg.eigvalsh(self.terms_mm)))


def stretched_ball(points_mm: Array, unknowns: Array, derivatives: Array) -> Array:
    """Derivatives (n, m + 5): those of a ball (n, m) at points (n, 3), then by its stretch terms."""
    ways = points_mm - unknowns[:3]
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
    x, y, z = ways.T
    terms = np.column_stack((x * x - z * z, y * y - z * z, x * y, x * z, y * z))
    return np.column_stack((derivatives, derivatives[:, RADIUS, None] * terms))
