"""Random fields over space: seeded, smooth, of a stated size and correlation length.

A field is a sum of cosine waves whose directions and lengths follow the spectrum of a Matérn covariance
(Rahimi and Recht, Random features for large-scale kernel machines, 2007).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sim.world.noise import noise
from sim.world.rigid import Array, Vectors

WAVES = 128


class SmoothField:
    """A field of standard deviation 1 over its seeds, with Matérn covariance of this length and order.

    Order 0.5 is rough, 1.5 and 2.5 smooth, and infinity a squared exponential.
    """

    def __init__(self, seed: int, name: str, length_mm: float, order: float = 1.5) -> None:
        generator = noise(seed, name, 0)
        spectrum = generator.standard_normal((WAVES, 3))
        stretch = generator.standard_normal(WAVES) if np.isinf(order) else generator.gamma(order, size=WAVES)
        if not np.isinf(order):
            spectrum /= np.sqrt(stretch / order)[:, None]
        self._waves = spectrum.T / length_mm
        self._phases = generator.uniform(0.0, 2.0 * np.pi, WAVES)

    def at(self, points_mm: Vectors) -> Array:
        """Return the field (n,) at points (n, 3)."""
        phases = np.asarray(points_mm) @ self._waves + self._phases
        # Single precision is many times faster, and wrong by a millionth.
        waves = np.cos(phases.astype(np.float32))
        return np.asarray(waves.sum(axis=1, dtype=float) * np.sqrt(2.0 / WAVES))


@lru_cache(maxsize=16)
def smooth_field(seed: int, name: str, length_mm: float, order: float = 1.5) -> SmoothField:
    """Return a field, kept for further questions."""
    return SmoothField(seed, name, length_mm, order)
