"""Random heads with fiducials, and readings of them, following the thesis' protocol (5.3.1).

The thesis used eight adhesive markers on each of three patients, with unpublished coordinates. Here they are
on the upper side of three ellipsoids of different sizes, the same in every run. A reading displaces the
sites, takes a random subset, adds noise and outliers on both sides, and shuffles both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from ronna_hw.arrays import Array
from studies.sphere_errors import THESIS_PAIRING_MM

PATIENTS = (1, 2, 3)
HALF_AXES_MM = {1: (72.0, 92.0, 66.0), 2: (76.0, 97.0, 71.0), 3: (80.0, 102.0, 76.0)}
SITES = 8
SITES_SEED = 2018
APART_MM = 25.0
LOWEST_SITE = -0.1  # fraction of the semi-axis: no screw below the ear
DISPLACED_MM = 10.0  # radius of the ball within which each site is displaced
OUTLIER_BALL_MM = 300.0
AWAY_MM = 500.0
IMAGE_SIGMA_MM = THESIS_PAIRING_MM
PHYSICAL_SIGMA_MM = 0.56


class NoiseReading(StrEnum):
    """Two interpretations of the thesis' standard deviations, which it does not define."""

    PER_AXIS = "per axis"
    NORM = "norm"


def sites_mm(patient: int) -> Array:
    """Return a patient's eight fiducial sites (8, 3)."""
    random = np.random.default_rng([SITES_SEED, patient])
    sites: list[Array] = []
    while len(sites) < SITES:
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        site = np.asarray(HALF_AXES_MM[patient]) * direction
        if direction[2] > LOWEST_SITE and all(np.linalg.norm(site - one) > APART_MM for one in sites):
            sites.append(site)
    return np.array(sites)


def uniform_in_ball(count: int, radius_mm: float, random: np.random.Generator) -> Array:
    """Draw points (count, 3) uniformly from a ball about the origin."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction * radius_mm * random.uniform(size=(count, 1)) ** (1.0 / 3.0))


def draw_noise(
    shape: tuple[int, ...], sigma_mm: float, reading: NoiseReading, random: np.random.Generator
) -> Array:
    """Draw noise (..., 3): Gaussian on every axis, or of Gaussian length in a random direction."""
    if reading is NoiseReading.PER_AXIS:
        return np.asarray(random.normal(size=shape) * sigma_mm)
    direction = random.normal(size=shape)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.asarray(direction * random.normal(size=(*shape[:-1], 1)) * sigma_mm)


def draw_strays(
    points: Array, outliers: int, to_frame: Callable[[Array], Array], random: np.random.Generator
) -> Array:
    """Draw outliers (runs, outliers, 3) uniformly from a ball about the centre of points (runs, k, 3)."""
    runs = len(points)
    strays = uniform_in_ball(runs * outliers, OUTLIER_BALL_MM, random).reshape(runs, outliers, 3)
    return np.asarray(points.mean(axis=1, keepdims=True) + strays)


def per_axis_mm(sigma_mm: float, reading: NoiseReading) -> float:
    return sigma_mm if reading is NoiseReading.PER_AXIS else sigma_mm / float(np.sqrt(3.0))


def variance_from_thesis_mm2(noise: NoiseReading) -> float:
    """Return the combined per-axis variance of both point sets, from the errors stated in the thesis."""
    return per_axis_mm(IMAGE_SIGMA_MM, noise) ** 2 + per_axis_mm(PHYSICAL_SIGMA_MM, noise) ** 2


def draw_pose(random: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(random.normal(size=3) * AWAY_MM, Rotation.random(rng=random))


NoiseOf = Callable[[tuple[int, ...], float, NoiseReading, np.random.Generator], Array]
# Outliers for points (runs, k, 3), their number, the map of the head's frame to that of the points.
StraysOf = Callable[[Array, int, Callable[[Array], Array], np.random.Generator], Array]


@dataclass(frozen=True, eq=False)
class Readings:
    """Points of both sets (runs, n, 3) in mm, corresponding indices (runs, k, 2), and true rotations."""

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
    *,
    noise_of: NoiseOf = draw_noise,
    strays_of: StraysOf = draw_strays,
    distort: Callable[[Array, np.random.Generator], Array] | None = None,
) -> Readings:
    """Draw `runs` readings of `count` fiducials at displaced sites (s, 3), with outliers in both sets.

    `distort` returns where the tracker sees points (runs, k, 3) of its own frame, before its noise.
    """
    sites = len(sites_mm)
    displaced = sites_mm + uniform_in_ball(runs * sites, displaced_mm, random).reshape(runs, sites, 3)
    chosen = random.permuted(np.tile(np.arange(sites), (runs, 1)), axis=1)[:, :count]
    points = np.take_along_axis(displaced, chosen[:, :, None], axis=1)
    rotations, shifts = Rotation.random(runs, rng=random), random.normal(size=(runs, 1, 3)) * AWAY_MM

    def to_room(in_head: Array) -> Array:
        return np.asarray(in_head @ rotations.as_matrix().swapaxes(1, 2) + shifts)

    imaged = points + noise_of(points.shape, IMAGE_SIGMA_MM, noise, random)
    image, image_order = _shuffle(imaged, strays_of(imaged, outliers, np.asarray, random), random)
    placed = to_room(points) if distort is None else distort(to_room(points), random)
    tracked = placed + noise_of(points.shape, PHYSICAL_SIGMA_MM, noise, random)
    physical, physical_order = _shuffle(tracked, strays_of(tracked, outliers, to_room, random), random)
    columns = [np.argsort(order, axis=1)[:, :count] for order in (image_order, physical_order)]
    return Readings(image, physical, np.stack(columns, axis=2), rotations)


def _shuffle(points: Array, strays: Array, random: np.random.Generator) -> tuple[Array, NDArray[np.intp]]:
    """Append the strays, shuffle, and return the points with the permutation."""
    everything = np.concatenate([points, strays], axis=1)
    order = random.permuted(np.tile(np.arange(everything.shape[1]), (len(points), 1)), axis=1)
    return np.take_along_axis(everything, order[:, :, None], axis=1), order
