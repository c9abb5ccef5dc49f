"""Surface of a head by signed distance, and rays that meet it.

Coordinates are those of the CT frame in mm: DICOM LPS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.world.rigid import Array, Vectors

LEAST_STEP_MM = 1.0  # so that a ray along the surface goes on; a shorter way through the head may be missed
MOST_STEPS = 40
TINY = 1e-12
REFINEMENTS = 12  # of a hit between the last place outside and the first inside
CLOSE_MM = 1e-4  # of a hit to the surface


class HeadSurface(Protocol):
    """Skin of a head."""

    def distance_mm(self, points_mm: Vectors) -> Array:
        """Return the distance (n,) of points (n, 3), positive outside; exact near the surface."""
        ...

    def normals(self, points_mm: Vectors) -> Vectors:
        """Return outward unit normals (n, 3) at points near the surface."""
        ...

    def cast(self, origins_mm: Vectors, directions: Vectors, furthest_mm: float) -> Array:
        """Return the distance (n,) along unit directions to the first hit; NaN without one."""
        ...


class Distance(Protocol):
    """Signed distance of points (n, 3)."""

    def __call__(self, points_mm: Vectors, /) -> Array:
        """Return the distances (n,)."""
        ...


def march(
    distance_mm: Distance,
    origins_mm: Vectors,
    directions: Vectors,
    furthest_mm: float | Array,
    start_mm: Array | None = None,
) -> Array:
    """Return where rays first meet a surface, by sphere tracing from `start_mm`; NaN where they do not.

    A ray that starts inside meets nothing.
    """
    origins, directions = np.asarray(origins_mm, dtype=float), np.asarray(directions, dtype=float)
    along = np.zeros(len(origins)) if start_mm is None else np.array(start_mm, dtype=float)
    furthest = np.broadcast_to(furthest_mm, along.shape)
    active = np.flatnonzero(along <= furthest)
    outside, before = along.copy(), np.full(len(origins), np.nan)  # last place outside and distance there
    inside, beyond = np.full(len(origins), np.nan), np.full(len(origins), np.nan)
    for _ in range(MOST_STEPS):
        if not len(active):
            break
        away = distance_mm(origins[active] + along[active, None] * directions[active])
        met = away <= 0.0
        inside[active[met]], beyond[active[met]] = along[active[met]], away[met]
        active, away = active[~met], away[~met]
        outside[active], before[active] = along[active], away
        along[active] += np.maximum(away, LEAST_STEP_MM)
        active = active[along[active] <= furthest[active]]
    hit = np.full(len(origins), np.nan)
    found = np.flatnonzero(np.isfinite(beyond) & np.isfinite(before))
    hit[found] = _between(
        lambda rows, at: distance_mm(origins[found[rows]] + at[:, None] * directions[found[rows]]),
        (outside[found], before[found]),
        (inside[found], beyond[found]),
    )
    return hit


def _between(
    distance_mm: Callable[[NDArray[np.intp], Array], Array],
    outside: tuple[Array, Array],
    inside: tuple[Array, Array],
) -> Array:
    """Return the roots between places with their distances, by false position after Illinois."""
    (low, above), (high, below) = outside, inside
    found = high.copy()
    rows = np.arange(len(low))
    for _ in range(REFINEMENTS):
        middle = low + (high - low) * above / np.maximum(above - below, TINY)
        found[rows] = middle
        away = distance_mm(rows, middle)
        is_outside = away > 0.0
        # The end that stays counts half, so that it does not stay for good.
        low, high = np.where(is_outside, middle, low), np.where(is_outside, high, middle)
        above, below = np.where(is_outside, away, 0.5 * above), np.where(is_outside, 0.5 * below, away)
        going = np.abs(away) > CLOSE_MM
        rows, low, high, above, below = (one[going] for one in (rows, low, high, above, below))
        if not len(rows):
            break
    return found
