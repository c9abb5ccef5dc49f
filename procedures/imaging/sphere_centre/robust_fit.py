"""Robust least squares: Cauchy weights, Gauss-Newton with adaptive damping."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ronna_hw.robust_scale import robust_sigma

Array = NDArray[np.float64]
Model = Callable[[Array], tuple[Array, Array]]  # parameters (m,) to values (n,) and derivatives (n, m)

STEPS = 25
DONE_MM = 5e-5
CAUCHY = 2.385  # 95 % efficiency on Gaussian noise
FLAT_TO = 6.0  # standard deviations, at which the weight is a half
MIN_NOISE_HU = 0.5  # rounding to whole HU alone causes 0.3
MIN_GROWTH = 0.1
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-7, 1e6
BLOCK = 512  # rows; for larger products BLAS starts threads that cost more than they save


def minimise(model: Model, values: Array, start: Array, limits: Callable[[Array], Array]) -> Array | None:
    """The parameters that best fit `values` (n,), the first three a position in mm; None without convergence.

    `limits` keeps the parameters in range.
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
    """The same for flat weights."""
    return _growth(4.0 * weights**2 - 3.0 * weights, weights)


def _growth(by_residual: Array, weights: Array) -> float:
    """`by_residual` (n,) are the derivatives of w·r."""
    return max(float(np.mean(by_residual)), MIN_GROWTH) / float(np.mean(weights))


def products(one: Array, other: Array) -> Array:
    """`one`ᵀ `other` for (n, k) and (n, m), in blocks of rows."""
    total = np.zeros((one.shape[1], other.shape[1]))
    for row in range(0, len(one), BLOCK):
        total += one[row : row + BLOCK].T @ other[row : row + BLOCK]
    return total


def _cost(residuals: Array, noise: float) -> float:
    return float(np.log1p((residuals / (CAUCHY * noise)) ** 2).sum())
