"""How uncertain is a fit when the noise of neighbouring voxels is correlated?

CT noise is: treating voxels as independent would promise two to three times too much. The correlation is
measured on the residuals of the fit itself and carried through to the estimate (the "sandwich" with a
stationary noise model and a tapered window, after Conley, J. Econometrics 92 (1999)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.robust_fit import products

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

WINDOW_MM = 3.0  # noise of voxels further apart counts as independent
MIN_VARIANCE_MM2 = 1e-8  # 0.1 µm: keeps the result positive definite on noise-free data


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Noise that is alike everywhere and correlated between neighbours.

    `variance` is that of one voxel, `slow_variance` that of a sum over many neighbours, per voxel.
    """

    index: tuple[NDArray[np.int64], ...]
    padded: tuple[int, ...]
    density: Array  # over the half spectrum
    variance: float
    slow_variance: float

    @classmethod
    def of_residuals(cls, where: NDArray[np.int64], pull: Array, unknowns: int, spacing_mm: Array) -> Self:
        """From the weighted residuals (n,) of a fit of so many unknowns, at voxel indices (n, 3)."""
        freedom = len(pull) / max(len(pull) - unknowns, 1)
        index = tuple((where - where.min(axis=0)).T)
        lags = np.ceil(WINDOW_MM / spacing_mm).astype(int)
        padded = tuple(
            int(fft.next_fast_len(int(axis.max()) + 1 + int(lag), real=True))
            for axis, lag in zip(index, lags, strict=True)
        )
        sums = fft.irfftn(np.abs(_spectrum(index, padded, pull)) ** 2, s=padded)
        pairs = fft.irfftn(np.abs(_spectrum(index, padded, np.ones(len(pull)))) ** 2, s=padded)
        correlation = freedom * sums / np.maximum(pairs, 1.0) * _taper(padded, spacing_mm)
        density = np.maximum(fft.rfftn(correlation).real, 0.0)
        variance = freedom * float(np.mean(pull**2))
        return cls(
            index,
            padded,
            density * _multiplicity(padded) / float(np.prod(padded)),
            variance,
            max(float(correlation.sum()), variance),
        )

    def covariance_mm2(self, influence: Array) -> Array:
        """Covariance (k, k) of what `influence` (n, k), in mm per HU, makes of the noise.

        Never smaller than for independent noise.
        """
        spectra = [_spectrum(self.index, self.padded, column) for column in influence.T]
        correlated = np.array(
            [[float(np.sum(self.density * (a * b.conj()).real)) for b in spectra] for a in spectra]
        )
        independent = self.variance * products(influence, influence)
        return _raised_to(correlated, independent) + MIN_VARIANCE_MM2 * np.eye(len(spectra))


def _spectrum(index: tuple[NDArray[np.int64], ...], padded: tuple[int, ...], values: Array) -> Spectrum:
    grid = np.zeros(padded)
    grid[index] = values
    return np.asarray(fft.rfftn(grid))


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
