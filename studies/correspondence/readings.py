"""Readings drawn according to the thesis' protocol (5.3.1), many runs of a condition at once.

Every run displaces the patient's marker sites, takes a random subset, adds noise and outliers on both sides,
and shuffles both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from studies.heads import (
    AWAY_MM,
    DISPLACED_MM,
    IMAGE_SIGMA_MM,
    OUTLIER_BALL_MM,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    disturbance,
    in_balls,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Readings:
    """Points of both sides (runs, n, 3) mm, the corresponding indices (runs, k, 2), true rotations."""

    image_mm: Array
    physical_mm: Array
    pairs: NDArray[np.intp]
    rotations: Rotation

    def __len__(self) -> int:
        return len(self.image_mm)


def draw_readings(
    sites_mm: Array,
    count: int,
    outliers: int,
    noise: NoiseReading,
    runs: int,
    random: np.random.Generator,
    displaced_mm: float = DISPLACED_MM,
) -> Readings:
    """`runs` readings of `count` fiducials at displaced sites (s, 3), with outliers on both sides."""
    sites = len(sites_mm)
    displaced = sites_mm + in_balls(runs * sites, displaced_mm, random).reshape(runs, sites, 3)
    chosen = random.permuted(np.tile(np.arange(sites), (runs, 1)), axis=1)[:, :count]
    points = np.take_along_axis(displaced, chosen[:, :, None], axis=1)
    rotations, shifts = Rotation.random(runs, rng=random), random.normal(size=(runs, 1, 3)) * AWAY_MM
    turned = points @ rotations.as_matrix().swapaxes(1, 2) + shifts
    image, image_order = _shuffled(
        points + disturbance(points.shape, IMAGE_SIGMA_MM, noise, random), outliers, random
    )
    physical, physical_order = _shuffled(
        turned + disturbance(points.shape, PHYSICAL_SIGMA_MM, noise, random), outliers, random
    )
    where = [np.argsort(order, axis=1)[:, :count] for order in (image_order, physical_order)]
    return Readings(image, physical, np.stack(where, axis=2), rotations)


def _shuffled(points: Array, outliers: int, random: np.random.Generator) -> tuple[Array, NDArray[np.intp]]:
    """Points and outliers about their centre, in random order, and the permutation."""
    runs, count, _ = points.shape
    strays = in_balls(runs * outliers, OUTLIER_BALL_MM, random).reshape(runs, outliers, 3)
    everything = np.concatenate([points, points.mean(axis=1, keepdims=True) + strays], axis=1)
    order = random.permuted(np.tile(np.arange(count + outliers), (runs, 1)), axis=1)
    return np.take_along_axis(everything, order[:, :, None], axis=1), order
