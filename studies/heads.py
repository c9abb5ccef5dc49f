"""Heads with fiducials for the correspondence studies, after the thesis' protocol (5.3.1).

The thesis used eight adhesive markers on each of three patients, with unpublished coordinates. Here they are
on the upper side of three ellipsoids of different sizes, the same in every run.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

Array = NDArray[np.float64]

PATIENTS = (1, 2, 3)
HALF_AXES_MM = {1: (72.0, 92.0, 66.0), 2: (76.0, 97.0, 71.0), 3: (80.0, 102.0, 76.0)}
SITES = 8
SITES_SEED = 2018
APART_MM = 25.0
LOWEST_SITE = -0.1  # fraction of the semi-axis: no screw below the ear
DISPLACED_MM = 10.0  # radius of the ball within which each site is displaced
OUTLIER_BALL_MM = 300.0
AWAY_MM = 500.0
IMAGE_SIGMA_MM = 0.17
PHYSICAL_SIGMA_MM = 0.56


class NoiseReading(StrEnum):
    """The two possible meanings of a standard deviation in the thesis, which does not specify it."""

    PER_AXIS = "per axis"
    NORM = "norm"


def sites_mm(patient: int) -> Array:
    """The eight sites (8, 3) of a patient."""
    random = np.random.default_rng([SITES_SEED, patient])
    sites: list[Array] = []
    while len(sites) < SITES:
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        site = np.asarray(HALF_AXES_MM[patient]) * direction
        if direction[2] > LOWEST_SITE and all(np.linalg.norm(site - one) > APART_MM for one in sites):
            sites.append(site)
    return np.array(sites)


def in_balls(count: int, radius_mm: float, random: np.random.Generator) -> Array:
    """Uniform points in a ball about the origin, (count, 3)."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction * radius_mm * random.uniform(size=(count, 1)) ** (1.0 / 3.0))


def disturbance(
    shape: tuple[int, ...], sigma_mm: float, reading: NoiseReading, random: np.random.Generator
) -> Array:
    """Noise (..., 3): Gaussian on every axis, or of Gaussian length in a random direction."""
    if reading is NoiseReading.PER_AXIS:
        return np.asarray(random.normal(size=shape) * sigma_mm)
    direction = random.normal(size=shape)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.asarray(direction * random.normal(size=(*shape[:-1], 1)) * sigma_mm)


def per_axis_mm(sigma_mm: float, reading: NoiseReading) -> float:
    """Standard deviation per axis for the solvers: a Gaussian length is spread over three axes."""
    return sigma_mm if reading is NoiseReading.PER_AXIS else sigma_mm / float(np.sqrt(3.0))


def stated_variance_mm2(noise: NoiseReading) -> float:
    """Variance per axis of both sets together, from the errors stated in the thesis."""
    return per_axis_mm(IMAGE_SIGMA_MM, noise) ** 2 + per_axis_mm(PHYSICAL_SIGMA_MM, noise) ** 2


def any_pose(random: np.random.Generator) -> RigidTransform:
    """A random orientation, somewhere in the room."""
    return RigidTransform.from_components(random.normal(size=3) * AWAY_MM, Rotation.random(rng=random))
