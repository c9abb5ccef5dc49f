"""Covariance of the noise of neighbouring voxels, and its effect on a fit.

Treating voxels as independent would understate the error two- to threefold, and weight low-frequency noise,
which is strong, like high-frequency noise, which is weak. The spectrum is measured on the residuals of a fit
(correlation with a tapered window, after Conley, J. Econometrics 92 (1999)); the noise absorbed by the fit is
added back, as in restricted maximum likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.sphere_centre.voxel_spectra import Spectrum, VoxelGrid

Array = NDArray[np.float64]

WINDOW_MM = 3.0  # noise of voxels farther apart counts as independent
PASSES = 3  # the fit absorbs a few per cent: restored to 0.1 % in two passes


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Stationary noise, correlated between neighbours.

    `power` is its spectrum, HU² per voxel, over the half spectrum of the grid.
    """

    grid: VoxelGrid
    power: Array

    @classmethod
    def of_fit(cls, grid: VoxelGrid, pull: Array, taken: Spectrum, least: float) -> Self:
        """From the weighted residuals (n,) of a fit with derivatives whose spectra are `taken` (m, ...).

        No frequency counts as less noisy than `least`, relative to the variance.
        """
        pulled = np.abs(grid.spectra(pull[:, None])[0]) ** 2
        given = grid.projected(taken)
        pairs = fft.irfftn(np.abs(grid.spectra(np.ones((len(pull), 1)))[0]) ** 2, s=grid.padded)
        scale = _taper(grid) / np.maximum(_mirrored(pairs), 1.0)
        least_hu2 = least * float(np.mean(pull**2))
        power = np.zeros(pulled.shape)
        for _ in range(PASSES):
            sums = fft.irfftn(pulled + power * given, s=grid.padded)
            power = np.maximum(fft.rfftn(_mirrored(sums) * scale).real, least_hu2)
        return cls(grid, power)

    def with_more(self, power_hu2: float) -> CorrelatedNoise:
        """With additional white noise of this power."""
        return replace(self, power=self.power + power_hu2)

    @property
    def slow_power(self) -> float:
        """Power of noise that is correlated over many voxels."""
        return float(self.power[0, 0, 0])


def _mirrored(correlation: Array) -> Array:
    """The mean over both directions along each axis: scan noise has no handedness."""
    for axis in range(3):
        correlation = 0.5 * (correlation + np.roll(np.flip(correlation, axis), 1, axis))
    return correlation


def _taper(grid: VoxelGrid) -> Array:
    """Weights of the lags: one up to half the window, then falling to zero."""
    beyond = np.clip(2.0 * np.sqrt(grid.squared_lags_mm2()) / WINDOW_MM - 1.0, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * beyond)))
