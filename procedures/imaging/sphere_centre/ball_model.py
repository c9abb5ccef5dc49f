"""Model of a scanned ball on an uneven background, its stretch, and the robust fit of such a model.

Near the surface of a ball of radius R, blurred by a Gaussian of covariance S = diag(sz², sxy², sxy²),

    I(x) = out + b(x) + (in - out) / 2 · erfc( (r + t / 2r - R) / (√2 s) ),   r = |x - c|,
    s² = nᵀ S n along the radial direction n,   t = trace(S) - s²  (the curvature of the surface),

with a polynomial b that represents metal streaks across the neighbourhood.

A stretched body has its surface at R + q(n) along each direction n, with q of second degree and zero mean: an
ellipsoid to first order. Stretch is the main difference between a short rod with round ends and a ball.
Fitted together with ball and background, it is known to a few hundredths of a millimetre.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ronna_hw.robust_scale import robust_sigma

Array = NDArray[np.float64]

# order of the parameters: the centre (slice, row, column), then these, then the background coefficients
OUT, IN, SZ, SXY, RADIUS = 3, 4, 5, 6, 7
BALL = 8
SLOPE = slice(BALL, BALL + 3)

TERMS = 5

Model = Callable[[Array], tuple[Array, Array]]  # parameters (m,) to values (n,) and derivatives (n, m)

STEPS = 25
DONE_MM = 5e-5
CAUCHY = 2.385  # 95 % efficiency on Gaussian noise
FLAT_TO = 6.0  # standard deviations, at which the weight is a half
MIN_NOISE_HU = 0.5  # rounding to whole HU alone causes 0.3
MIN_GROWTH = 0.1
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-7, 1e6
BLOCK = 512  # rows; for larger products BLAS starts threads that cost more than they save


def polynomial(places: Array, degrees: Iterable[int]) -> Array:
    """Products (n, m) of `degrees` coordinates of `places` (n, 3), degree by degree."""
    chosen = [one for degree in degrees for one in combinations_with_replacement(range(3), degree)]
    columns = np.empty((len(places), len(chosen)))
    for number, axes in enumerate(chosen):
        columns[:, number] = places[:, axes[0]]
        for axis in axes[1:]:
            columns[:, number] *= places[:, axis]
    return columns


def intensities(points_mm: Array, unknowns: Array, background: Array) -> tuple[Array, Array]:
    """Intensities (n,) HU at points (n, 3) grid mm, and their derivatives (n, 8 + m) by the parameters.

    `background` (n, m) are the polynomial's terms at the points. The derivatives neglect that the blur varies
    with the direction from the centre and shifts the edge: both effects are small, and fits converge without
    them.
    """
    offsets = points_mm - unknowns[:3]
    r = np.maximum(np.linalg.norm(offsets, axis=1), 1e-6)
    n = offsets / r[:, None]
    variance_z, variance_xy = unknowns[SZ] ** 2, unknowns[SXY] ** 2
    along_z = n[:, 0] ** 2
    s2 = variance_xy + (variance_z - variance_xy) * along_z
    s = np.sqrt(s2)
    bend = (variance_z + 2 * variance_xy - s2) / (2 * np.maximum(r, unknowns[SXY]))
    u = (r + bend - unknowns[RADIUS]) / (np.sqrt(2.0) * s)
    cover = 0.5 * erfc(u)
    contrast = unknowns[IN] - unknowns[OUT]
    fall = contrast * np.exp(-(u**2)) / (np.sqrt(2.0 * np.pi) * s)  # -dI/dr
    derivatives = np.empty((len(r), len(unknowns)))
    derivatives[:, :3] = (fall * (1.0 - bend / r))[:, None] * n
    derivatives[:, OUT] = 1.0 - cover
    derivatives[:, IN] = cover
    # through u = d / (√2 s): du/ds = -u / s, with ds/dsz = sz n_z² / s and ds/dsxy = sxy (1 - n_z²) / s
    by_s = fall * np.sqrt(2.0) * u
    derivatives[:, SZ] = by_s * unknowns[SZ] * along_z / s
    derivatives[:, SXY] = by_s * unknowns[SXY] * (1.0 - along_z) / s
    derivatives[:, RADIUS] = fall
    derivatives[:, BALL:] = background
    return unknowns[OUT] + contrast * cover + background @ unknowns[BALL:], derivatives


@dataclass(frozen=True, eq=False)
class Stretch:
    """Distance of a body's surface from a ball's along each direction n: n' terms n, in mm.

    `terms_mm` (3, 3) along slice, row and column; `deviation_mm` is the standard deviation of a term.
    """

    terms_mm: Array
    deviation_mm: float

    @classmethod
    def of_last_terms(cls, found: Array, covariance: Array) -> Self:
        """Extract the stretch from the parameters of a stretched ball and their covariance."""
        a, b, c, d, e = found[-TERMS:].tolist()
        matrix = np.array([[a, c / 2, d / 2], [c / 2, b, e / 2], [d / 2, e / 2, -a - b]])
        variance = float(np.trace(covariance[-TERMS:, -TERMS:])) / TERMS
        return cls(matrix, float(np.sqrt(variance)))

    @property
    def difference_mm(self) -> float:
        """Longest minus shortest semi-axis."""
        return float(np.ptp(np.linalg.eigvalsh(self.terms_mm)))


def stretched_ball(points_mm: Array, unknowns: Array, derivatives: Array) -> Array:
    """Append to a ball's derivatives (n, m) at points (n, 3) those by its stretch terms, (n, m + 5)."""
    ways = points_mm - unknowns[:3]
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-6)
    x, y, z = ways.T
    terms = np.column_stack((x * x - z * z, y * y - z * z, x * y, x * z, y * z))
    return np.column_stack((derivatives, derivatives[:, RADIUS, None] * terms))


def minimise(model: Model, values: Array, start: Array, limits: Callable[[Array], Array]) -> Array | None:
    """Fit `values` (n,) by Gauss-Newton with Cauchy weights and adaptive damping; None without convergence.

    The first three parameters are a position in mm; `limits` keeps all of them in range.
    """
    unknowns = start
    damping = START_DAMPING
    modelled, jacobian = model(unknowns)
    residuals = values - modelled
    moved_mm = np.inf
    for _ in range(STEPS):
        noise = scale(residuals)
        weighted = cauchy_weights(residuals, noise)[:, None] * jacobian
        normal = products(jacobian, weighted)
        gradient = weighted.T @ residuals
        cost = _cost(residuals, noise)
        while damping < MOST_DAMPING:
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), gradient)
            trial = limits(unknowns + step)
            modelled, trial_jacobian = model(trial)
            trial_residuals = values - modelled
            if _cost(trial_residuals, noise) <= cost:
                break
            if np.abs(step[:3]).max() < DONE_MM:
                return unknowns
            damping *= 10.0
        else:
            return None
        moved_mm = float(np.abs(trial[:3] - unknowns[:3]).max())
        unknowns, jacobian, residuals = trial, trial_jacobian, trial_residuals
        damping = max(damping / 10.0, LEAST_DAMPING)
        if moved_mm < DONE_MM:
            return unknowns
    return unknowns if moved_mm < 20 * DONE_MM else None


def scale(residuals: Array) -> float:
    """Robust standard deviation of the residuals."""
    return max(robust_sigma(residuals), MIN_NOISE_HU)


def cauchy_weights(residuals: Array, noise: float) -> Array:
    """Weights (n,) from 1 down to almost zero for outliers."""
    return np.asarray(1.0 / (1.0 + (residuals / (CAUCHY * noise)) ** 2))


def flat_weights(residuals: Array, noise: float) -> Array:
    """Weights (n,) of 1 for whatever noise explains, and almost zero for outliers.

    Cauchy weights distort the noise itself, which raises the high end of its spectrum: half the gain from
    whitening would be lost.
    """
    return np.asarray(1.0 / (1.0 + (residuals / (FLAT_TO * noise)) ** 4))


def cauchy_growth(weights: Array) -> float:
    """Mean growth of the weighted residual w·r with r, relative to the weight, for Cauchy weights."""
    return _growth(2.0 * weights**2 - weights, weights)


def flat_growth(weights: Array) -> float:
    """Mean growth of the weighted residual w·r with r, relative to the weight, for flat weights."""
    return _growth(4.0 * weights**2 - 3.0 * weights, weights)


def _growth(by_residual: Array, weights: Array) -> float:
    """Mean growth, given the derivatives (n,) of w·r by r."""
    return max(float(np.mean(by_residual)), MIN_GROWTH) / float(np.mean(weights))


def products(one: Array, other: Array) -> Array:
    """Compute `one`ᵀ `other` for (n, k) and (n, m), in blocks of rows."""
    total = np.zeros((one.shape[1], other.shape[1]))
    for row in range(0, len(one), BLOCK):
        total += one[row : row + BLOCK].T @ other[row : row + BLOCK]
    return total


def _cost(residuals: Array, noise: float) -> float:
    return float(np.log1p((residuals / (CAUCHY * noise)) ** 2).sum())
