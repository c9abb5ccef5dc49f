"""The skin of generated heads: an ellipsoid, and the cap of it that a surgeon can reach. CT frame."""

from __future__ import annotations

from math import cos

import numpy as np
from numpy.typing import NDArray

from sim.world.rigid import rotation_towards

Vector = NDArray[np.float64]

SEMI_AXES_MM = (75.0, 95.0, 90.0)  # left-right, front-back, foot-head
CENTRE_CT_MM = (3.2, -41.7, 812.4)  # anywhere but the origin, so that a swapped axis shows
CAP_AXIS_CT = (0.0, -1.0, 1.0)  # forehead to vertex: towards the ceiling


def drawn_direction(generator: np.random.Generator, axis: Vector, half_angle_rad: float) -> Vector:
    """A direction within a cone, uniform over its solid angle."""
    cosine = generator.uniform(cos(half_angle_rad), 1.0)
    turn = generator.uniform(0.0, 2 * np.pi)
    sine = (1 - cosine**2) ** 0.5
    frame = rotation_towards(axis, (1.0, 0.0, 0.0))
    direction: Vector = frame @ np.array([sine * np.cos(turn), sine * np.sin(turn), cosine])
    return direction


def skin_at(direction: Vector) -> tuple[Vector, Vector]:
    """Point on the skin in that direction from the centre, relative to it, and the outward normal."""
    axes = np.array(SEMI_AXES_MM)
    point = direction / np.linalg.norm(direction / axes)
    normal = point / axes**2
    return point, normal / np.linalg.norm(normal)
