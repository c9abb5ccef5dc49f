"""Strays beyond those of the scene: spheres added by a fault, and flickering reflections."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim.polaris.optics.measuring_volume import Volume
from sim.world.noise import noise

Vectors = NDArray[np.float64]

INNER_SHARE = 0.7  # share of the volume's depth and width in which they are
REFLECTION_PRESENCE = 0.3  # share of frames in which a reflection is bright enough
REFLECTION_SPREAD_MM = 3.0  # a reflection wanders over its surface
SPHERES, REFLECTIONS = "tracker extra spheres", "tracker reflections"


@lru_cache(maxsize=8)
def extra_strays(seed: int, count: int, volume: Volume) -> Vectors:
    """Positions (n, 3) of further spheres; the first ones do not depend on the count."""
    return _places(seed, SPHERES, count, volume)


@lru_cache(maxsize=8)
def reflecting_places(seed: int, count: int, volume: Volume) -> Vectors:
    """Positions (n, 3) of reflecting surfaces."""
    return _places(seed, REFLECTIONS, count, volume)


def reflections(places_mm: Vectors, generator: np.random.Generator) -> Vectors:
    """The reflections (m, 3) of one frame."""
    shines = generator.random(len(places_mm)) < REFLECTION_PRESENCE
    wandered = places_mm + generator.normal(0.0, REFLECTION_SPREAD_MM, places_mm.shape)
    found: Vectors = wandered[shines]
    return found


def _places(seed: int, what: str, count: int, volume: Volume) -> Vectors:
    near, far = volume.depths_mm
    middle, half = (near + far) / 2.0, INNER_SHARE * (far - near) / 2.0
    places = np.empty((count, 3))
    for index in range(count):
        x, y, z = noise(seed, what, index).uniform(-1.0, 1.0, 3)
        depth_mm = middle + half * z
        half_x, half_y = volume.half_widths_mm(depth_mm)
        places[index] = (INNER_SHARE * half_x * x, INNER_SHARE * half_y * y, -depth_mm)
    return places
