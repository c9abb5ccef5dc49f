"""Bone laid bare: a head whose scalp is folded away over a part of the skull."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from ronna_hw.calibration import Numbers3, Strict
from sim.world.head_surface.skull_surface import SkullSurface
from sim.world.head_surface.surface import HeadSurface, march
from sim.world.rigid import Array, Vectors


class BareBone(Strict):
    """The part of the head where the scalp is open in the theatre; the CT shows it closed."""

    centre_ct_mm: Numbers3 = Field(description="Middle of the opening on the skin, CT frame.")
    radius_mm: Annotated[float, Field(ge=5, le=120)] = Field(description="Radius of the opening.")


class HeadWithBareBone:
    """A head's skin outside a ball around the opening, and the skull within."""

    def __init__(self, skin: HeadSurface, skull: SkullSurface, opening: BareBone) -> None:
        self.skin, self.skull, self.opening = skin, skull, opening

    def shows_bone(self, points_mm: Vectors) -> Array:
        """Return whether points (n,) of the surface are bone."""
        return np.asarray(self._inside_mm(points_mm) > 0.0)

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        skin = np.maximum(self.skin.distance_mm(points_mm), self._inside_mm(points_mm))
        return np.asarray(np.minimum(skin, self.skull.distance_mm(points_mm)))

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        bare = self.shows_bone(points_mm)[:, None]
        return np.asarray(np.where(bare, self.skull.normals(points_mm), self.skin.normals(points_mm)))

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        on_skin = self.skin.cast(origins_mm, directions, furthest_mm)
        places = np.asarray(origins_mm) + np.nan_to_num(on_skin)[:, None] * np.asarray(directions)
        through = np.flatnonzero(np.isfinite(on_skin) & (self._inside_mm(places) > 0.0))
        # Through the opening a ray meets bone, or the open edge of the scalp.
        start, end = on_skin[through], np.full(len(through), furthest_mm)
        found = on_skin.copy()
        origins, along = (np.asarray(one)[through] for one in (origins_mm, directions))
        found[through] = march(self.distance_mm, origins, along, end, start)
        return found

    def _inside_mm(self, points_mm: Vectors) -> Array:
        """Return the depth (n,) of points within the ball of the opening."""
        away = np.asarray(points_mm, dtype=float) - np.array(self.opening.centre_ct_mm)
        return np.asarray(self.opening.radius_mm - np.linalg.norm(away, axis=1))
