"""Parts of a head by name, from their place on the surface in the CT."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.registration.surface.surface import Surface
from ronna_hw.arrays import Array

CRANIUM_MM = 70.0  # below the vertex: length and width of a head are taken above
USUAL_HALF_LENGTH_MM = 95.0  # of a head; the heights below are those of such a head

# Heights below the vertex of a usual head, mm. Source: usual proportions of an adult head (U).
VAULT_MM, BROWS_MM, EYES_MM, CHEEKS_MM, HEAD_MM = 50.0, 98.0, 130.0, 160.0, 165.0
NOSE_HALF_WIDTH_MM = 15.0
FRONT, BACK = -0.45, 0.55  # places along a head, of its half length; the front is negative


@dataclass(frozen=True)
class HeadAxes:
    """Middle of a head, its vertex and size, by its surface in patient coordinates (LPS)."""

    middle_mm: Array  # (x, y) of the cranium
    vertex_mm: float
    half_length_mm: float

    @classmethod
    def of(cls, surface: Surface) -> Self:
        """Measure the cranium by the surface, as `of_points`."""
        return cls.of_points(surface.points_mm)

    @classmethod
    def of_points(cls, points: Array) -> Self:
        """Measure the cranium by points (n, 3), the part below the vertex that every CT for surgery shows."""
        vertex = float(points[:, 2].max())
        cranium = points[points[:, 2] > vertex - CRANIUM_MM, :2]
        low, high = cranium.min(axis=0), cranium.max(axis=0)
        return cls(0.5 * (low + high), vertex, float(0.5 * (high - low)[1]))

    @cached_property
    def scale(self) -> float:
        """Size of this head by a usual one."""
        return self.half_length_mm / USUAL_HALF_LENGTH_MM

    @property
    def centre_mm(self) -> Array:
        """Place (3,) amid the deep targets: half a usual head's length below the vertex."""
        return np.append(self.middle_mm, self.vertex_mm - USUAL_HALF_LENGTH_MM * self.scale)

    def depth_mm(self, points_mm: Array) -> Array:
        """Return how far points (n, 3) lie below the vertex, scaled to a usual head."""
        return np.asarray((self.vertex_mm - points_mm[:, 2]) / self.scale)

    def name_parts(self, points_mm: Array) -> NDArray[np.object_]:
        """Name the part of the head that each point (n, 3) belongs to."""
        depth = self.depth_mm(points_mm)
        across = (points_mm[:, 0] - self.middle_mm[0]) / self.scale
        along = (points_mm[:, 1] - self.middle_mm[1]) / self.half_length_mm
        side = np.where(across > 0.0, "left ", "right ").astype(object)
        front, back = along < FRONT, along > BACK
        is_nose = np.abs(across) < NOSE_HALF_WIDTH_MM
        return np.select(
            [
                depth < VAULT_MM,
                back & (depth < HEAD_MM),
                back,
                front & (depth < BROWS_MM),
                depth > CHEEKS_MM,
                front & is_nose,
                front & (depth < EYES_MM),
                front,
                depth < BROWS_MM,
            ],
            ["vault", "occiput", "neck", "forehead", "jaw", "nose", "eyes", "cheeks", side + "temple"],
            side + "ear",
        )
