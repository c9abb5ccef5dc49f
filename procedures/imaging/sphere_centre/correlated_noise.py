"""Weighting of a fit's residuals by the noise at each spatial frequency.

CT noise has low frequencies: its spectrum falls off where that of a sharp edge still carries information.
Equal weights for all voxels therefore lose accuracy and understate the error two- to threefold. Generalized
least squares weights the residuals by the inverse of the measured noise spectrum (Aitken 1935; in imaging,
the prewhitening observer). Where the voxels end, a filter would take the end of a smooth term for detail:
those terms are not filtered.

The spectrum is measured on the residuals of a fit (correlation with a tapered window, after Conley, J.
Econometrics 92 (1999)); the noise absorbed by the fit is added back, as in restricted maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.sphere_centre.ball_model import products
from ronna_hw.arrays import Array, Mask

Spectrum = NDArray[np.complex128]

SAME_SPACE = 1e-10  # columns with a smaller remainder are in the space of the others

WINDOW_MM = 3.0  # noise of voxels farther apart counts as independent
PASSES = 3  # the fit absorbs a few per cent: restored to 0.1 % in two passes

Pull = Callable[[Array], Array]  # parameters (m,) to weighted residuals w·r (n,)

STEPS = 2
MOST_MOVED_MM = 0.5  # the previous fit cannot have been off by more


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Voxels at `index` of a grid zero-padded to shape `padded`, with room for lags up to a limit.

    Converts values at the voxels to spectra and back, zero elsewhere. Spectra are half spectra; `share` is
    the contribution of each coefficient to a sum over the grid.
    """

    index: tuple[NDArray[np.int64], ...]
    padded: tuple[int, ...]
    spacing_mm: Array
    share: Array

    @classmethod
    def from_indices(cls, voxel_index: NDArray[np.int64], largest_lag_mm: float, spacing_mm: Array) -> Self:
        """Build a padded grid with this spacing from voxel indices (n, 3)."""
        index = tuple((voxel_index - voxel_index.min(axis=0)).T)
        lags = np.ceil(largest_lag_mm / spacing_mm).astype(int)
        padded = tuple(
            int(fft.next_fast_len(int(axis.max()) + 1 + int(lag), real=True))
            for axis, lag in zip(index, lags, strict=True)
        )
        return cls(index, padded, spacing_mm, _multiplicity(padded) / float(np.prod(padded)))

    def spectra(self, columns: Array) -> Spectrum:
        """Return the spectra (k, ...) of values (n, k) at the voxels."""
        spectra = []
        for column in columns.T:
            grid = np.zeros(self.padded)
            grid[self.index] = column
            spectra.append(fft.rfftn(grid))
        return np.array(spectra)

    def values(self, spectra: Spectrum) -> Array:
        """Return the values (n, k) at the voxels from spectra (k, ...)."""
        return np.column_stack([fft.irfftn(one, s=self.padded)[self.index] for one in spectra])

    def products(self, one: Spectrum, other: Spectrum, filtered: Array | float = 1.0) -> Array:
        """Return scalar products (k, m) of values with spectra (k, ...) and (m, ...), one side filtered."""
        return products(_parts(one).T, _parts(other * (filtered * self.share)).T)

    def measure_absorbed_power(self, spectra: Spectrum) -> Array:
        """Return the spectral power of unit white noise projected onto the span of spectra (k, ...)."""
        values, vectors = np.linalg.eigh(self.products(spectra, spectra))
        kept = values > SAME_SPACE * values[-1]
        modes = (vectors[:, kept] / np.sqrt(values[kept])).T @ _parts(spectra)
        power = np.einsum("kn,kn->n", modes, modes)
        return np.asarray((power[0::2] + power[1::2]).reshape(spectra.shape[1:]))

    def squared_lags_mm2(self) -> Array:
        """Return the squared length of each lag on the grid."""
        squared = np.zeros(self.padded)
        for axis, (count, step_mm) in enumerate(zip(self.padded, self.spacing_mm, strict=True)):
            lag_mm = np.minimum(np.arange(count), count - np.arange(count)) * step_mm
            squared += (lag_mm**2).reshape([-1 if other == axis else 1 for other in range(3)])
        return squared


def _parts(spectra: Spectrum) -> Array:
    """Interleave real and imaginary parts, (k, 2 n)."""
    return np.ascontiguousarray(spectra.reshape(len(spectra), -1)).view(np.float64)


def _multiplicity(shape: tuple[int, ...]) -> Array:
    """Count how many full-spectrum coefficients each half-spectrum coefficient represents."""
    counts = np.full(shape[2] // 2 + 1, 2.0)
    counts[0] = 1.0
    if shape[2] % 2 == 0:
        counts[-1] = 1.0
    return counts


@dataclass(frozen=True, eq=False)
class CorrelatedNoise:
    """Stationary noise with correlation between neighbouring voxels.

    `power` is its spectrum, HU² per voxel, over the half spectrum of the grid.
    """

    grid: VoxelGrid
    power: Array

    @classmethod
    def from_fit(cls, grid: VoxelGrid, pull: Array, derivative_spectra: Spectrum, least: float) -> Self:
        """Estimate the noise from a fit's weighted residuals (n,) and the spectra of its derivatives.

        No frequency counts as less noisy than `least`, relative to the variance.
        """
        pulled = np.abs(grid.spectra(pull[:, None])[0]) ** 2
        absorbed_share = grid.measure_absorbed_power(derivative_spectra)
        pairs = fft.irfftn(np.abs(grid.spectra(np.ones((len(pull), 1)))[0]) ** 2, s=grid.padded)
        scale = _taper(grid) / np.maximum(_symmetrize(pairs), 1.0)
        least_hu2 = least * float(np.mean(pull**2))
        power = np.zeros(pulled.shape)
        for _ in range(PASSES):
            sums = fft.irfftn(pulled + power * absorbed_share, s=grid.padded)
            power = np.maximum(fft.rfftn(_symmetrize(sums) * scale).real, least_hu2)
        return cls(grid, power)

    @property
    def slow_power(self) -> float:
        """Power of noise correlated over many voxels."""
        return float(self.power[0, 0, 0])


def _symmetrize(correlation: Array) -> Array:
    """Average over both directions of each axis, since scan noise has no handedness."""
    for axis in range(3):
        correlation = 0.5 * (correlation + np.roll(np.flip(correlation, axis), 1, axis))
    return correlation


def _taper(grid: VoxelGrid) -> Array:
    """Return lag weights: 1 up to half the window, then falling to 0."""
    past_half = np.clip(2.0 * np.sqrt(grid.squared_lags_mm2()) / WINDOW_MM - 1.0, 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * past_half)))


@dataclass(frozen=True, eq=False)
class WhitenedStep:
    """Estimating equations for parameters (m,) from n voxels; the first three are a position in mm.

    Each of the `instruments` (n, m) times the weighted residuals must vanish or, for a parameter shrunk
    towards 0 with `stiffness` (m,), equal the restoring term. `response` (m, m) is the derivative of these
    sums with respect to the parameters, `noise` (m, m) their uncertainty.
    """

    instruments: Array
    response: Array
    noise: Array
    stiffness: Array

    @classmethod
    def from_fit(
        cls, noise: CorrelatedNoise, derivatives: Array, spectra: Spectrum, growth: float, smooth: Mask
    ) -> Self:
        """Set up the equations from weighted derivatives (n, m) at a robust fit, without shrinkage.

        `growth` is the growth of the weighted residual with the residual, relative to its weight; `smooth`
        (m,) marks the derivatives that are smooth where the voxels end.
        """
        instruments = derivatives / noise.slow_power
        instruments[:, ~smooth] = noise.grid.values(spectra[~smooth] / noise.power)
        filtered = spectra / noise.slow_power
        filtered[~smooth] = noise.grid.spectra(instruments[:, ~smooth])
        return cls(
            instruments,
            growth * products(instruments, derivatives),
            noise.grid.products(filtered, filtered, noise.power),
            np.zeros(len(smooth)),
        )

    @cached_property
    def answer(self) -> Array:
        """Response (m, m) of the parameters to the sums over the voxels."""
        return np.asarray(np.linalg.pinv(self.response + np.diag(self.stiffness)))

    @property
    def covariance(self) -> Array:
        """Covariance (m, m) of the parameters due to noise."""
        return np.asarray(self.answer @ self.noise @ self.answer.T)

    @property
    def influence(self) -> Array:
        """Shift (n, 3) of the centre, in mm per HU of weighted residual at each voxel."""
        return np.asarray(self.instruments @ self.answer[:3].T)

    def settle(self, unknowns: Array, pull: Pull) -> Array | None:
        """Solve the equations near given parameters; return None if the solution is too far away."""
        settled = unknowns
        for _ in range(STEPS):
            sums = self.instruments.T @ pull(settled)
            settled = settled + self.answer @ (sums - self.stiffness * settled)
        return settled if np.abs(settled[:3] - unknowns[:3]).max() < MOST_MOVED_MM else None
