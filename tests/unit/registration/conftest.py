"""Head-like fiducials and noisy readings of them, for the tests of this folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from ronna_hw.arrays import Array

HEAD_HALF_AXES_MM = np.array([75.0, 95.0, 70.0])


@dataclass(frozen=True)
class Reading:
    """Shuffled noisy points of both sides, the true pairs and the true transform."""

    image_mm: Array
    physical_mm: Array
    pairs: set[tuple[int, int]]
    truth: RigidTransform


def head_fiducials(count: int, random: np.random.Generator, apart_mm: float = 25.0) -> Array:
    """Sites on the upper side of a head, (count, 3) mm."""
    sites: list[Array] = []
    while len(sites) < count:
        direction = random.normal(size=3)
        direction /= np.linalg.norm(direction)
        site = HEAD_HALF_AXES_MM * direction
        if direction[2] > -0.1 and all(np.linalg.norm(site - other) > apart_mm for other in sites):
            sites.append(site)
    return np.array(sites)


def in_ball(count: int, radius_mm: float, random: np.random.Generator) -> Array:
    """Uniform points in a ball about the origin, (count, 3) mm."""
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.asarray(direction * radius_mm * random.uniform(size=(count, 1)) ** (1 / 3))


def pose(random: np.random.Generator) -> RigidTransform:
    """Any orientation, half a metre away."""
    return RigidTransform.from_components(random.normal(size=3) * 500.0, Rotation.random(rng=random))


def read_points(
    points_mm: Array,
    outliers: int,
    random: np.random.Generator,
    sigma_image_mm: float = 0.17,
    sigma_physical_mm: float = 0.56,
) -> Reading:
    """Both sides of one reading as the thesis' protocol makes it, noise per axis."""
    truth = pose(random)
    image = points_mm + random.normal(size=points_mm.shape) * sigma_image_mm
    physical = truth.apply(points_mm) + random.normal(size=points_mm.shape) * sigma_physical_mm
    image = np.vstack([image, image.mean(axis=0) + in_ball(outliers, 300.0, random)])
    physical = np.vstack([physical, physical.mean(axis=0) + in_ball(outliers, 300.0, random)])
    image_order, physical_order = random.permutation(len(image)), random.permutation(len(physical))
    where_image, where_physical = np.argsort(image_order), np.argsort(physical_order)
    pairs = {(int(where_image[k]), int(where_physical[k])) for k in range(len(points_mm))}
    return Reading(image[image_order], physical[physical_order], pairs, truth)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(20180)


@pytest.fixture(scope="session")
def fiducials() -> Callable[..., Array]:
    return head_fiducials


@pytest.fixture
def reading() -> Callable[..., Reading]:
    return read_points


@pytest.fixture
def ball() -> Callable[..., Array]:
    return in_ball


@pytest.fixture
def any_pose() -> Callable[..., RigidTransform]:
    return pose
