"""Measurement of a single marker: noise that grows with depth, plus a fixed smooth bias.

Tracker frame, mm. With a stereo base of half a metre, depth is measured three to four times worse than the
other two axes, and both degrade with the square of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from sim.polaris.optics.bias_field import bias_field
from sim.polaris.optics.measuring_volume import Volume
from sim.world.scene.model import TrackerTruth

Vectors = NDArray[np.float64]

HALF_BASE_MM = 250.0  # the two sensors are on y, left and right of the origin
# Field of view of both sensors: not public; it only has to contain every volume.
FIELD_DEPTHS_MM = (300.0, 4000.0)
FIELD_SLOPES = (tan(radians(27.0)), tan(radians(32.0)))  # of |x| and |y|


@dataclass(frozen=True)
class Sight:
    """Mean and standard deviation of the measurement of n points; both (n, 3)."""

    mean_mm: Vectors
    sigma_mm: Vectors

    def measured(self, standard_normal: Vectors) -> Vectors:
        """One measurement (n, 3) from standard normal numbers (n, 3)."""
        points: Vectors = self.mean_mm + self.sigma_mm * standard_normal
        return points


class Optics:
    """The pair of sensors. The scene's noise is defined at the middle of the unit's first volume."""

    def __init__(self, truth: TrackerTruth, seed: int, volumes: tuple[Volume, ...]) -> None:
        self._sigma_mm = np.array([truth.noise_xy_mm, truth.noise_xy_mm, truth.noise_z_mm])
        self._middle_mm = volumes[0].middle_depth_mm
        stated = (truth.bias_mm, truth.bias_extended_mm)
        self.bias_field = bias_field(seed, tuple(zip(volumes[: len(stated)], stated, strict=False)))

    def sight(self, points_mm: Vectors) -> Sight:
        """Mean and noise of markers at `points_mm` (n, 3)."""
        growth = (points_mm[:, 2:] / self._middle_mm) ** 2
        return Sight(points_mm + self.bias_field.at(points_mm), growth * self._sigma_mm)


def eyes_mm() -> Vectors:
    """Positions of the left and the right sensor (2, 3)."""
    return np.array([[0.0, -HALF_BASE_MM, 0.0], [0.0, HALF_BASE_MM, 0.0]])


def in_field(points_mm: Vectors) -> NDArray[np.bool_]:
    """Which of the points (n, 3) are in the field of view of both sensors."""
    x, y, z = points_mm.T
    nearest, farthest = FIELD_DEPTHS_MM
    slope_x, slope_y = FIELD_SLOPES
    field: NDArray[np.bool_] = (
        (-z >= nearest) & (-z <= farthest) & (np.abs(x) <= -z * slope_x) & (np.abs(y) <= -z * slope_y)
    )
    return field
