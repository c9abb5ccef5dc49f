"""Outer surface of the skull under a face: the cranium below the scalp, and the bones of the face.

Over the vault the scalp is as thick as under the plain ellipsoid, so that CT and drill agree there.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from sim.world.head_surface.blending import Field, Values, carve, cone, ellipsoid, unite
from sim.world.head_surface.distance_grid import DistanceGrid
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.head_surface.surface import march
from sim.world.rigid import Array, Vectors
from sim.world.skull import SCALP_MM

ROUND_MM = 6.0  # of the joints between the bones of the face
ORBIT_MM, ORBIT_BEFORE_MM = (18.0, 24.0, 16.5), 6.0  # semi-axes; its middle before the eye's
BROW_SKIN_MM = 3.5


class SkullSurface:
    """The skull of a head; its parts of a solid, as if bare."""

    def __init__(self, head: ParametricHead) -> None:
        self.head = head

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        return np.asarray(self._field_at(points_mm).distance())

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        return self._field_at(points_mm).normals()

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        start, end = self.fine_grid.approach(origins_mm, directions, furthest_mm)
        return march(self.distance_mm, origins_mm, directions, end, start)

    @cached_property
    def grid(self) -> DistanceGrid:
        """Coarse distances, with which rays skip empty space."""
        low, high = self.head.bounds_mm
        return DistanceGrid.sample(self._cautious, low, high)

    @cached_property
    def fine_grid(self) -> DistanceGrid:
        """Finer distances, with which rays come close to the surface."""
        return self.grid.refine(self._cautious)

    def _cautious(self, x: Values, y: Values, z: Values) -> Values:
        return self.field(x, y, z).cautious()

    def field(self, x: Values, y: Values, z: Values) -> Field:
        """Return distance and gradient at points of the CT frame."""
        return self.head.mirrored(x, unite(self.cranium(x, y, z), self.face_bones(x, y, z), ROUND_MM))

    def cranium(self, x: Values, y: Values, z: Values) -> Field:
        """Return the cranium without the orbits, at the scalp's depth to first order; gradient along |x|."""
        side, y, z = self.head.own(x, y, z)
        x = np.abs(side)
        skin = ellipsoid(x, y, z, (0.0, 0.0, 0.0), self.head.semi_axes_mm)
        return carve(Field(skin.value + SCALP_MM, skin.x, skin.y, skin.z), self._orbit(x, y, z), 3.0)

    def _orbit(self, x: Values, y: Values, z: Values) -> Field:
        eye_x, eye_y, eye_z = self.head.landmarks.eye(self.head.face)
        return ellipsoid(x, y, z, (eye_x, eye_y - ORBIT_BEFORE_MM, eye_z), ORBIT_MM)

    def face_bones(self, x: Values, y: Values, z: Values) -> Field:
        """Return upper jaw, cheekbones, nasal bone, brows and lower jaw; gradient along |x|."""
        face, marks = self.head.face, self.head.landmarks
        side, y, z = self.head.own(x, y, z)
        x = np.abs(side)
        front, sellion, menton = marks.face_front_mm, marks.sellion_mm, marks.menton_mm
        face_half, jaw_half = 0.5 * face.face_width_mm, 0.5 * face.jaw_width_mm
        upper = ellipsoid(
            x, y, z, (0.0, front + 60.0, sellion - 36.0), (face_half - 17.0, 48.0, 0.33 * face.face_length_mm)
        )
        cheek = ellipsoid(x, y, z, (face_half - 24.0, front + 40.0, sellion - 32.0), (17.0, 20.0, 8.0))
        lower = ellipsoid(x, y, z, (0.0, front + 54.0, menton + 40.0), (jaw_half - 12.0, 40.0, 29.0))
        chin = ellipsoid(x, y, z, (0.0, front + 22.0, menton + 18.0), (13.0, 12.0, 11.0))
        nose_y = marks.nose_root_mm
        nasal = cone(x, y, z, (0.0, nose_y, sellion + 2.0), (0.0, nose_y - 4.0, sellion - 16.0), (4.0, 3.0))
        start, end = marks.brow(face)
        radius = face.brow_mm - BROW_SKIN_MM
        bones = unite(unite(upper, cheek, 10.0), nasal, 3.0)
        bones = unite(bones, cone(x, y, z, start, end, (radius, radius)), ROUND_MM)
        bones = carve(bones, self._orbit(x, y, z), 3.0)
        return unite(bones, unite(lower, chin, 8.0), ROUND_MM)

    def _field_at(self, points_mm: Vectors) -> Field:
        x, y, z = np.ascontiguousarray(np.asarray(points_mm, dtype=float).reshape(-1, 3).T)
        return self.field(x, y, z)
