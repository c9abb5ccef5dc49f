"""Metal streaks over the slices of a ball: in each slice a smooth random field of unknown size.

A streak is confined to the slices of its metal, so neighbouring slices say nothing about it. Within a slice
it is a Gaussian process, slow compared with the ball's edge and thus hardly confused with it, written as a
sum of cosines with a few coefficients per slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.region import Region

Array = NDArray[np.float64]

# chosen on straight bands with standard deviations of 1.2 to 3 mm across `plain`: anything shorter follows
# the edge, which doubled the error; a ball's edge is 0.5 mm wide
LENGTH_MM = 3.0
HIGHEST = 0.2  # cycles per mm: above this, such a process has a thousandth of its power
NOISE_BAND = (0.1, 0.3)  # cycles per mm: the band used to estimate the noise, in which the edge is blurred
FEWEST_VOXELS = 40  # of a slice, to estimate its noise
CLEAR_SHARE = 0.05  # of the largest eigenvalue: patterns that the voxels see less of are dropped
ROOM_MM = 2.0  # from the voxels to the end of the cosines' period


@dataclass(frozen=True, eq=False)
class Waves:
    """Cosines over a square of `side_mm` around `middle_mm` (row, column): wave numbers (m, 2)."""

    middle_mm: Array
    side_mm: float
    numbers: NDArray[np.int64]

    @classmethod
    def between(cls, middle_mm: Array, side_mm: float, lowest: float, highest: float) -> Self:
        """All waves from `lowest` to `highest` cycles per mm."""
        count = int(2.0 * side_mm * highest) + 1
        numbers = np.array([(row, column) for row in range(count) for column in range(count)])
        cycles = np.hypot(*numbers.T) / (2.0 * side_mm)
        return cls(middle_mm, side_mm, numbers[(cycles >= lowest) & (cycles <= highest)])

    @property
    def cycles_per_mm(self) -> Array:
        """(m,)"""
        return np.asarray(np.hypot(*self.numbers.T) / (2.0 * self.side_mm))

    def at(self, rows_mm: Array, columns_mm: Array) -> Array:
        """Their values (n, m) at positions (n,) in the slice."""
        row, column = self._along(rows_mm, 0), self._along(columns_mm, 1)
        return np.asarray(row[:, self.numbers[:, 0]] * column[:, self.numbers[:, 1]])

    def sums(self, coefficients: Array, rows_mm: Array, columns_mm: Array) -> Array:
        """Their sum over a whole grid (rows, columns); 0 beyond the square."""
        table = np.zeros(self.numbers.max(axis=0) + 1)
        table[tuple(self.numbers.T)] = coefficients
        field = self._along(rows_mm, 0) @ table @ self._along(columns_mm, 1).T
        inside = [
            np.abs(places - middle) < 0.5 * self.side_mm
            for places, middle in zip((rows_mm, columns_mm), self.middle_mm, strict=True)
        ]
        return np.asarray(field * np.outer(*inside))

    def _along(self, places_mm: Array, axis: int) -> Array:
        share = (places_mm - self.middle_mm[axis]) / self.side_mm + 0.5
        return np.asarray(np.cos(np.pi * np.outer(share, np.arange(self.numbers[:, axis].max() + 1))))


@dataclass(frozen=True, eq=False)
class NoiseModes:
    """Patterns (k, m) over k voxels of a slice, whose indices among all voxels are `rows` (k,)."""

    rows: NDArray[np.intp]
    patterns: Array


def noise_power(modes: tuple[NoiseModes, ...], residuals: Array) -> float:
    """Mean square of residuals (n,) along the modes, HU² per voxel."""
    squares = sum(float(((residuals[one.rows] @ one.patterns) ** 2).sum()) for one in modes)
    return float(squares / max(sum(one.patterns.shape[1] for one in modes), 1))


@dataclass(frozen=True, eq=False)
class SliceField:
    """The field over the voxels of a fit: which of them are in each slice, and its waves there (n, m).

    The variance of a coefficient is that of the slice's field.
    """

    waves: Waves
    scales: Array  # (m,) of a wave for a coefficient of 1
    slices: tuple[NDArray[np.intp], ...]
    heights_mm: Array
    terms: tuple[Array, ...]
    noise_terms: tuple[Array, ...]

    @classmethod
    def around(cls, points_mm: Array, radius_mm: float) -> Self:
        """For voxels (n, 3) grid mm within this radius of their centroid."""
        middle_mm = 0.5 * (points_mm.min(axis=0) + points_mm.max(axis=0))[1:]
        side_mm = 2.0 * (radius_mm + ROOM_MM)
        waves = Waves.between(middle_mm, side_mm, 0.0, HIGHEST)
        noisy = Waves.between(middle_mm, side_mm, *NOISE_BAND)
        power = np.exp(-2.0 * (np.pi * LENGTH_MM * waves.cycles_per_mm) ** 2)
        power *= np.prod(np.where(waves.numbers == 0, 1.0, 2.0), axis=1)  # the mean square of a cosine is 1/2
        scales = np.sqrt(power / power.sum())
        heights_mm = np.unique(points_mm[:, 0])
        slices = tuple(np.flatnonzero(points_mm[:, 0] == height) for height in heights_mm)
        places = [(points_mm[one, 1], points_mm[one, 2]) for one in slices]
        terms = tuple(waves.at(*place) * scales for place in places)
        return cls(waves, scales, slices, heights_mm, terms, tuple(noisy.at(*place) for place in places))

    def noise_modes(self, clear: NDArray[np.bool_]) -> tuple[NoiseModes, ...]:
        """Combinations of waves in the noise band, orthonormal over a slice's clear voxels (n,)."""
        modes = []
        for one, waves in zip(self.slices, self.noise_terms, strict=True):
            seen = clear[one]
            if seen.sum() < FEWEST_VOXELS:
                continue
            values, vectors = np.linalg.eigh(waves[seen].T @ waves[seen])
            kept = values > CLEAR_SHARE * values[-1]
            modes.append(NoiseModes(one[seen], waves[seen] @ (vectors[:, kept] / np.sqrt(values[kept]))))
        return tuple(modes)

    def over(self, region: Region, coefficients: tuple[Array, ...]) -> Array:
        """The field over all voxels of a region (slices, rows, columns); 0 where nothing was fitted."""
        z, y, x = region.axes_mm()
        field = np.zeros(region.values.shape)
        for height_mm, found in zip(self.heights_mm, coefficients, strict=True):
            number = int(np.argmin(np.abs(z.ravel() - height_mm)))
            field[number] = self.waves.sums(found * self.scales, y.ravel(), x.ravel())
        return field
