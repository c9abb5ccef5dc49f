"""The unit's systematic error: a fixed smooth field over the volume.

A sum of plane waves drawn from the seed, times a power of the depth. Amplitude and power are chosen so that
the field has the stated rms length over each of two volumes. This is what data sheets call volumetric
accuracy: the mean error of many readings of a stationary marker.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim.polaris.optics.measuring_volume import Volume
from sim.world.noise import noise

Vectors = NDArray[np.float64]

WAVES = 8
WAVELENGTH_MM = (1500.0, 3000.0)  # longer than any tool: neighbouring markers share their bias
DEPTH_RATIO = 2.0  # of the z component to x and y
GRID_POINTS = 15  # per axis, used to scale the field
POWER_RANGE = (-6.0, 6.0)
POWER_STEPS = 20  # of the bisection


class BiasField:
    """The error (n, 3) at points (n, 3), tracker frame, mm."""

    def __init__(self, seed: int, stated: tuple[tuple[Volume, float], ...]) -> None:
        """`stated` pairs one or two volumes, the smaller first, with their rms length in mm."""
        generator = noise(seed, "tracker bias", 0)
        directions = generator.standard_normal((WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._waves = 2.0 * np.pi * directions / generator.uniform(*WAVELENGTH_MM, (WAVES, 1))
        self._phases = generator.uniform(0.0, 2.0 * np.pi, WAVES)
        self._amplitudes_mm = generator.standard_normal((WAVES, 3)) * (1.0, 1.0, DEPTH_RATIO)
        self._middle_mm = stated[0][0].middle_depth_mm
        self._power = 0.0
        sizes = [
            _Sizes(self.at(grid), self._depths(grid)) for grid in (_grid(volume) for volume, _ in stated)
        ]
        if len(stated) > 1 and stated[0][1] > 0.0:
            self._power = _fitting_power(sizes[0], sizes[1], stated[1][1] / stated[0][1])
        self._amplitudes_mm *= stated[0][1] / sizes[0].rms(self._power)

    def at(self, points_mm: Vectors) -> Vectors:
        """The systematic error of the unit at these points."""
        waves = np.sin(points_mm @ self._waves.T + self._phases) @ self._amplitudes_mm
        field: Vectors = waves * self._depths(points_mm)[:, None] ** self._power
        return field

    def _depths(self, points_mm: Vectors) -> Vectors:
        depths: Vectors = np.abs(points_mm[:, 2]) / self._middle_mm
        return depths


@cache
def bias_field(seed: int, stated: tuple[tuple[Volume, float], ...]) -> BiasField:
    """The field; finding its power takes longer than starting the rest of a unit."""
    return BiasField(seed, stated)


class _Sizes:
    """Rms length over a volume of a field times a power of the depth."""

    def __init__(self, field: Vectors, depths: Vectors) -> None:
        self._squares = (field * field).sum(axis=1)
        self._depths = depths

    def rms(self, power: float) -> float:
        return float(np.sqrt(np.mean(self._squares * self._depths ** (2.0 * power))))


def _fitting_power(small: _Sizes, large: _Sizes, ratio: float) -> float:
    """The power of the depth that yields this ratio of the two rms lengths; the ratio grows with it."""
    low, high = POWER_RANGE
    for _ in range(POWER_STEPS):
        middle = (low + high) / 2.0
        if large.rms(middle) < ratio * small.rms(middle):
            low = middle
        else:
            high = middle
    return (low + high) / 2.0


@cache
def _grid(volume: Volume) -> Vectors:
    """Points (n, 3) evenly spread over the volume, read-only."""
    near, far = volume.depths_mm
    x, y = volume.half_widths_mm(far)
    middles = (np.arange(GRID_POINTS) + 0.5) / GRID_POINTS
    axes = [low + (high - low) * middles for low, high in ((-x, x), (-y, y), (-far, -near))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = [volume.holds(*point) for point in points.tolist()]
    grid: Vectors = points[np.array(inside)]
    grid.flags.writeable = False
    return grid
