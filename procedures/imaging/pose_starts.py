"""Starts of a search for the pose of one head in another scan, and how far apart its ends are."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from ronna_hw.arrays import Array


def list_turned_starts(middle_mm: Array, there_mm: Array, turn_rad: float) -> Iterator[RigidTransform]:
    """Yield poses that carry one middle to the other: unturned, then turned either way about one axis."""
    for turns in product((0.0, -turn_rad, turn_rad), repeat=3):
        if np.count_nonzero(turns) < 2:
            rotation = Rotation.from_rotvec(turns)
            yield RigidTransform.from_components(there_mm - rotation.apply(middle_mm), rotation)


def measure_apart_mm(one: RigidTransform, other: RigidTransform, points_mm: Array) -> float:
    """Return the rms distance between points (n, 3) mm as two poses carry them."""
    return float(np.sqrt(np.square(one.apply(points_mm) - other.apply(points_mm)).sum(axis=1).mean()))
