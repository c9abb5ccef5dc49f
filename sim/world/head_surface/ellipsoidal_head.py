"""Head without a face: the ellipsoid of a scene."""

from __future__ import annotations

import numpy as np

from sim.world.head_surface.blending import Field, Values, ellipsoid
from sim.world.rigid import Array, Point, Vectors


class EllipsoidalHead:
    """The ellipsoid's surface; distances are exact near it."""

    def __init__(self, centre_ct_mm: Point, semi_axes_mm: Point) -> None:
        self.centre_ct_mm, self.semi_axes_mm = centre_ct_mm, semi_axes_mm

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        return np.asarray(self.field(*np.asarray(points_mm, dtype=float).T).distance())

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3)."""
        normals = (np.asarray(points_mm) - self.centre_ct_mm) / np.square(self.semi_axes_mm)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        start = (np.asarray(origins_mm) - self.centre_ct_mm) / self.semi_axes_mm
        along = np.asarray(directions) / self.semi_axes_mm
        a, b, c = (along * along).sum(1), (start * along).sum(1), (start * start).sum(1) - 1.0
        root = b * b - a * c
        hit = (-b - np.sqrt(np.maximum(root, 0.0))) / a
        return np.asarray(np.where((root >= 0.0) & (hit >= 0.0) & (hit <= furthest_mm), hit, np.nan))

    def field(self, x: Values, y: Values, z: Values) -> Field:
        """Return distance and gradient at points of the CT frame."""
        return ellipsoid(x, y, z, self.centre_ct_mm, self.semi_axes_mm)
