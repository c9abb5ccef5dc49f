"""Surface that a scan is registered to, whatever it comes from, and the error of its level in a CT."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ronna_hw.arrays import Array, Mask

LEVEL_SD_MM = 0.15  # of the surface's level in the CT, the same everywhere (U)
# Of what the edge is wider where a voxel is longer, as thick slices make it, standard deviation of the level.
# A threshold at a third or two thirds of an edge is off by a sixth of its width.
LEVEL_SHARE = 0.2


class Surface(Protocol):
    """Surface of a head in the CT frame.

    `points_mm` (m, 3) are samples a few millimetres apart, `normals` (m, 3) their outward directions.
    `voxel_mm` (3, 3) has the edges of a voxel as rows.
    """

    @property
    def points_mm(self) -> Array:
        """Samples (m, 3)."""
        ...

    @property
    def normals(self) -> Array:
        """Outward unit normals (m, 3) of the samples."""
        ...

    @property
    def voxel_mm(self) -> Array:
        """Edges (3, 3) of the voxels behind it, as rows."""
        ...

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Return signed distances (n,) along the normals (n, 3), positive outside, and which are valid."""
        ...


def level_errors_mm(normals: Array, voxel_mm: Array) -> Array:
    """Return displacements (n, 2) along normals (n, 3), CT frame, by errors of the level in the CT.

    One standard deviation each: the same everywhere, and by the width of the edge across longer voxels.
    """
    widths_mm = np.linalg.norm(normals @ voxel_mm.T, axis=1)
    wider_mm = widths_mm - np.linalg.norm(voxel_mm, axis=1).min()
    return np.column_stack([np.full(len(normals), LEVEL_SD_MM), LEVEL_SHARE * np.maximum(wider_mm, 0.0)])
