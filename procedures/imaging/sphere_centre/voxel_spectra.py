"""Values at the voxels of a fit as spectra, and back; zero outside those voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.sphere_centre.robust_fit import products

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]


SAME_SPACE = 1e-10  # columns with a smaller remainder are in the space of the others


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Voxels at `index` of a grid of shape `padded`, which leaves room for lags up to a limit.

    Spectra are half spectra; `share` is the contribution of each coefficient to a sum over the grid.
    """

    index: tuple[NDArray[np.int64], ...]
    padded: tuple[int, ...]
    spacing_mm: Array
    share: Array

    @classmethod
    def around(cls, where: NDArray[np.int64], largest_lag_mm: float, spacing_mm: Array) -> Self:
        """For voxel indices (n, 3) with this spacing."""
        index = tuple((where - where.min(axis=0)).T)
        lags = np.ceil(largest_lag_mm / spacing_mm).astype(int)
        padded = tuple(
            int(fft.next_fast_len(int(axis.max()) + 1 + int(lag), real=True))
            for axis, lag in zip(index, lags, strict=True)
        )
        return cls(index, padded, spacing_mm, _multiplicity(padded) / float(np.prod(padded)))

    def spectra(self, columns: Array) -> Spectrum:
        """Spectra (k, ...) of values (n, k) at the voxels."""
        spectra = []
        for column in columns.T:
            grid = np.zeros(self.padded)
            grid[self.index] = column
            spectra.append(fft.rfftn(grid))
        return np.array(spectra)

    def values(self, spectra: Spectrum) -> Array:
        """Values (n, k) at the voxels of spectra (k, ...)."""
        return np.column_stack([fft.irfftn(one, s=self.padded)[self.index] for one in spectra])

    def products(self, one: Spectrum, other: Spectrum, filtered: Array | float = 1.0) -> Array:
        """Scalar products (k, m) of the values behind spectra (k, ...) and (m, ...), one side filtered."""
        return products(_parts(one).T, _parts(other * (filtered * self.share)).T)

    def projected(self, spectra: Spectrum) -> Array:
        """The part of white noise of power 1 in the space of the values behind spectra (k, ...)."""
        values, vectors = np.linalg.eigh(self.products(spectra, spectra))
        kept = values > SAME_SPACE * values[-1]
        modes = (vectors[:, kept] / np.sqrt(values[kept])).T @ _parts(spectra)
        power = np.einsum("kn,kn->n", modes, modes)
        return np.asarray((power[0::2] + power[1::2]).reshape(spectra.shape[1:]))

    def squared_lags_mm2(self) -> Array:
        """Squared distance of each lag, over the grid."""
        squared = np.zeros(self.padded)
        for axis, (count, step_mm) in enumerate(zip(self.padded, self.spacing_mm, strict=True)):
            lag_mm = np.minimum(np.arange(count), count - np.arange(count)) * step_mm
            squared += (lag_mm**2).reshape([-1 if other == axis else 1 for other in range(3)])
        return squared


def _parts(spectra: Spectrum) -> Array:
    """Real and imaginary parts (k, 2 n), alternating."""
    return np.ascontiguousarray(spectra.reshape(len(spectra), -1)).view(np.float64)


def _multiplicity(shape: tuple[int, ...]) -> Array:
    """How many coefficients of the full spectrum each one of the half spectrum represents."""
    counts = np.full(shape[2] // 2 + 1, 2.0)
    counts[0] = 1.0
    if shape[2] % 2 == 0:
        counts[-1] = 1.0
    return counts
