"""The grain of the retro-reflective film: glass beads, each a little brighter or darker than the mean.

Space is divided into cubes of a bead's size, fixed to the sphere; a bead's brightness is derived from its
cube. The grain therefore turns and moves with the sphere, and the same sphere always looks the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Image
from sim.world.noise import noise

BEAD_MM = 0.05  # beads of retro-reflective film are 40 to 70 um
CONTRAST = 0.04  # standard deviation of the brightness
TABLE_SIZE = 1 << 16
# odd multipliers that spread neighbouring cubes over the table (Fibonacci hashing, one per axis)
MULTIPLIERS = (np.int32(0x1E3779B1), np.int32(0x05EBCA77), np.int32(0x42B2AE3D))


class Grain:
    """The film of one sphere."""

    def __init__(self, seed: int, number: int) -> None:
        values = noise(seed, f"film of sphere {number}", 0).standard_normal(TABLE_SIZE, dtype=np.float32)
        self._table: Image = np.float32(1.0) + np.float32(CONTRAST) * values

    def at(self, x_mm: Image, y_mm: Image, z_mm: Image) -> Image:
        """Brightness factor, mean 1, of surface points given in the sphere's own frame."""
        total: NDArray[np.int32] = np.zeros(x_mm.shape, dtype=np.int32)
        for position, multiplier in zip((x_mm, y_mm, z_mm), MULTIPLIERS, strict=True):
            cube = np.floor(position * np.float32(1.0 / BEAD_MM)).astype(np.int32)
            cube *= multiplier  # wraps around, as a hash should
            total ^= cube
        total >>= 12
        total &= TABLE_SIZE - 1
        grain: Image = self._table.take(total)
        return grain
