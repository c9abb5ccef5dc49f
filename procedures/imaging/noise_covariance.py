"""How uncertain is a fit when the noise of neighbouring voxels is correlated?

CT noise is: treating voxels as independent would promise two to three times too much. The correlation is
measured on the residuals of the fit itself and carried through to the estimate (the "sandwich" with a
stationary noise model and a tapered window, after Conley, J. Econometrics 92 (1999)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]

WINDOW_MM = 3.0  # noise of voxels further apart counts as independent
MIN_GROWTH = 0.1
MIN_VARIANCE_MM2 = 1e-8  # 0.1 µm: keeps the result positive definite on noise-free data


def covariance_of_centre(
    where: NDArray[np.int64], jacobian: Array, residuals: Array, weights: Array, spacing_mm: Array
) -> Array:
    """Covariance (3, 3) mm² of the first three unknowns of a weighted fit to n voxels.

    `where` (n, 3) are voxel indices, `jacobian` (n, m) the derivatives of the model in HU per unit,
    `residuals` (n,) HU, `weights` (n,) the robust weights of the last step. Never smaller than for
    independent noise.
    """
    weighted = weights[:, None] * jacobian
    # how fast the pull of a residual grows: 2w² - w is the derivative of r·w(r) for Cauchy weights
    growth = max(float(np.mean(2.0 * weights**2 - weights)), MIN_GROWTH)
    inverse = np.linalg.pinv(weighted.T @ jacobian * (growth / float(np.mean(weights))), hermitian=True)
    pull = weights * residuals
    influence = jacobian @ inverse[:, :3]  # mm by which one HU of pull moves the centre
    freedom = len(residuals) / max(len(residuals) - jacobian.shape[1], 1)
    independent = freedom * float(np.mean(pull**2)) * (influence.T @ influence)
    index = tuple((where - where.min(axis=0)).T)
    extent = tuple(int(axis.max()) + 1 for axis in index)
    lags = np.ceil(WINDOW_MM / spacing_mm).astype(int)
    padded = tuple(int(fft.next_fast_len(n + int(k), real=True)) for n, k in zip(extent, lags, strict=True))

    def spectrum(values: Array) -> NDArray[np.complex128]:
        grid = np.zeros(extent)
        grid[index] = values
        return np.asarray(fft.rfftn(grid, s=padded))

    products = fft.irfftn(np.abs(spectrum(pull)) ** 2, s=padded)
    pairs = fft.irfftn(np.abs(spectrum(np.ones(len(pull)))) ** 2, s=padded)
    correlation = freedom * products / np.maximum(pairs, 1.0) * _taper(padded, spacing_mm)
    density = np.maximum(fft.rfftn(correlation).real, 0.0) * _multiplicity(padded) / float(np.prod(padded))
    spectra = [spectrum(column) for column in influence.T]
    correlated = np.array([[float(np.sum(density * (a * b.conj()).real)) for b in spectra] for a in spectra])
    return _raised_to(correlated, independent) + MIN_VARIANCE_MM2 * np.eye(3)


def _taper(shape: tuple[int, ...], spacing_mm: Array) -> Array:
    """Weights of the lags: full up to half the window, then falling to nothing."""
    squared = np.zeros(shape)
    for axis, (count, step_mm) in enumerate(zip(shape, spacing_mm, strict=True)):
        lag_mm = np.minimum(np.arange(count), count - np.arange(count)) * step_mm
        squared = squared + (lag_mm**2).reshape([-1 if other == axis else 1 for other in range(3)])
    beyond = np.clip(2.0 * np.sqrt(squared) / WINDOW_MM - 1.0, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * beyond)))


def _multiplicity(shape: tuple[int, ...]) -> Array:
    """How many coefficients of the full spectrum each one of the half spectrum stands for."""
    counts = np.full(shape[2] // 2 + 1, 2.0)
    counts[0] = 1.0
    if shape[2] % 2 == 0:
        counts[-1] = 1.0
    return counts


def _raised_to(matrix: Array, floor: Array) -> Array:
    """The symmetric `matrix`, raised to the positive definite `floor` in every direction."""
    values, vectors = np.linalg.eigh(floor)
    root = (vectors * np.sqrt(np.maximum(values, MIN_VARIANCE_MM2))) @ vectors.T
    whitener = np.linalg.inv(root)
    ratios, turned = np.linalg.eigh(whitener @ matrix @ whitener)
    raised = root @ ((turned * np.maximum(ratios, 1.0)) @ turned.T) @ root
    return np.asarray(0.5 * (raised + raised.T))
