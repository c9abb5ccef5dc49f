"""How well the unit sees a single marker: noise that grows with depth, and a fixed smooth bias field.

Tracker frame, mm. A stereo base of half a metre measures depth three to four times worse than the other
two axes, and both worsen with the square of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.polaris.volume import PYRAMID
from sim.theatre.noise import noise
from sim.theatre.scene import TrackerTruth

Vectors = NDArray[np.float64]

MID_VOLUME_MM = 1675.0  # middle of the pyramid's depth, 950 to 2400 mm: where a scene states its noise
BIAS_WAVES = 6
BIAS_WAVELENGTH_MM = (1200.0, 2500.0)  # longer than any tool: neighbouring markers share their bias
BIAS_DEPTH_RATIO = 2.0  # of the z component to the others
CALIBRATION_GRID = 9  # points per axis over which the field is scaled to its stated size


@dataclass(frozen=True)
class Sight:
    """What the unit measures of points on average, and the standard deviation; both (n, 3)."""

    mean_mm: Vectors
    sigma_mm: Vectors

    def measured(self, standard_normal: Vectors) -> Vectors:
        """One measurement (n, 3), made of standard normal numbers (n, 3)."""
        points: Vectors = self.mean_mm + self.sigma_mm * standard_normal
        return points


class Optics:
    """The unit's eyes. The bias field is a sum of plane waves drawn from the seed.

    `bias_mm` of the scene is the root mean square of its length over the pyramid; it grows with depth.
    """

    def __init__(self, truth: TrackerTruth, seed: int) -> None:
        self._sigma_mm = np.array([truth.noise_xy_mm, truth.noise_xy_mm, truth.noise_z_mm])
        generator = noise(seed, "tracker bias", 0)
        directions = generator.standard_normal((BIAS_WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        lengths_mm = generator.uniform(*BIAS_WAVELENGTH_MM, (BIAS_WAVES, 1))
        self._waves = 2.0 * np.pi * directions / lengths_mm
        self._phases = generator.uniform(0.0, 2.0 * np.pi, BIAS_WAVES)
        amplitudes = generator.standard_normal((BIAS_WAVES, 3))
        amplitudes[:, 2] *= BIAS_DEPTH_RATIO
        self._amplitudes_mm = amplitudes
        lengths = np.linalg.norm(self.bias(_points_in_pyramid()), axis=1)
        self._amplitudes_mm = amplitudes * truth.bias_mm / np.sqrt(np.mean(lengths**2))

    def bias(self, points_mm: Vectors) -> Vectors:
        """The systematic error (n, 3) of the unit at these points."""
        waves = np.sin(points_mm @ self._waves.T + self._phases) @ self._amplitudes_mm
        field: Vectors = waves * (-points_mm[:, 2:] / MID_VOLUME_MM)
        return field

    def sight(self, points_mm: Vectors) -> Sight:
        """What the unit sees of markers at `points_mm` (n, 3)."""
        growth = (points_mm[:, 2:] / MID_VOLUME_MM) ** 2
        return Sight(points_mm + self.bias(points_mm), growth * self._sigma_mm)


def _points_in_pyramid() -> Vectors:
    far, _, near, *_ = PYRAMID.dimensions
    z = np.linspace(far / 100.0, near / 100.0, CALIBRATION_GRID)
    y = np.linspace(-800.0, 800.0, CALIBRATION_GRID)
    x = np.linspace(-700.0, 700.0, CALIBRATION_GRID)
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.array([point for point in grid if PYRAMID.holds(*point)])
