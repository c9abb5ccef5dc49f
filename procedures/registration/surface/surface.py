"""Surface that a scan is registered to, whatever it comes from."""

from __future__ import annotations

from typing import Protocol

from ronna_hw.arrays import Array, Mask


class Surface(Protocol):
    """Surface of a head in the CT frame.

    `points_mm` (m, 3) are samples a few millimetres apart, `normals` (m, 3) their outward directions.
    """

    @property
    def points_mm(self) -> Array:
        """Samples (m, 3)."""
        ...

    @property
    def normals(self) -> Array:
        """Outward unit normals (m, 3) of the samples."""
        ...

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Return signed distances (n,) along the normals (n, 3), positive outside, and which are valid."""
        ...
