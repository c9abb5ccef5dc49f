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
MOST_STEPS, SINGLE_STEPS, STEPS_AT_ONCE = 24, 4, 16
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
    start = np.zeros(len(origins)) if start_mm is None else np.asarray(start_mm, dtype=float)
    bracket = _Bracket(start, np.broadcast_to(furthest_mm, start.shape))

    def at(rows: NDArray[np.intp], along: Array) -> Array:
        return distance_mm(origins[rows] + along[:, None] * directions[rows])

    # Most rays go straight to the surface. The rest, along it, would take many short steps: several at once.
    for step in range(MOST_STEPS):
        if not len(bracket.active):
            break
        bracket.look(at, 1 if step < SINGLE_STEPS else STEPS_AT_ONCE)
    found = np.flatnonzero(np.isfinite(bracket.below) & np.isfinite(bracket.above))
    hit = np.full(len(origins), np.nan)
    hit[found] = _between(
        lambda rows, along: at(found[rows], along),
        (bracket.outside[found], bracket.above[found]),
        (bracket.inside[found], bracket.below[found]),
    )
    return hit


class _Bracket:
    """For each ray the last place outside and the first inside, with the distances there; NaN until found."""

    def __init__(self, start: Array, end: Array) -> None:
        self.outside, self.inside = start.copy(), np.full(len(start), np.nan)
        self.above, self.below = np.full(len(start), np.nan), np.full(len(start), np.nan)
        self._along, self._end = start.copy(), end
        self.active = np.flatnonzero(start <= end)

    def look(self, at: Callable[[NDArray[np.intp], Array], Array], places: int) -> None:
        """Look at so many places of each active ray, a least step apart, and go on by the last distance."""
        rows = self.active
        along = self._along[rows, None] + LEAST_STEP_MM * np.arange(places)
        away = at(np.repeat(rows, places), along.ravel()).reshape(along.shape)
        inside = away <= 0.0
        met, first = inside.any(axis=1), inside.argmax(axis=1)
        last = np.where(met, first - 1, places - 1)  # place outside, -1 if there is none
        own = np.arange(len(rows))
        some = last >= 0
        self.outside[rows[some]] = along[own[some], last[some]]
        self.above[rows[some]] = away[own[some], last[some]]
        self.inside[rows[met]], self.below[rows[met]] = (
            along[own[met], first[met]],
            away[own[met], first[met]],
        )
        self._along[rows] = along[:, -1] + np.maximum(away[:, -1], LEAST_STEP_MM)
        self.active = rows[~met & (self._along[rows] <= self._end[rows])]


def _between(
    distance_mm: Callable[[NDArray[np.intp], Array], Array],
    outside: tuple[Array, Array],
    inside: tuple[Array, Array],
) -> Array:
    """Return the roots between places with their distances, by false position after Illinois."""
    (low, above), (high, below) = outside, inside
    found = high.copy()
    rows: NDArray[np.intp] = np.arange(len(low))
    before = np.zeros(len(low))  # sign of the distance at the last place
    for _ in range(REFINEMENTS):
        middle = low + (high - low) * above / np.maximum(above - below, TINY)
        found[rows] = middle
        away = distance_mm(rows, middle)
        is_outside = away > 0.0
        # An end that stays for the second time counts half, so that it does not stay for good.
        again = np.where(np.sign(away) == before, 0.5, 1.0)
        low, high = np.where(is_outside, middle, low), np.where(is_outside, high, middle)
        above, below = (
            np.where(is_outside, away, again * above),
            np.where(is_outside, again * below, away),
        )
        going = np.abs(away) > CLOSE_MM
        before = np.sign(away)[going]
        low, high, above, below = (one[going] for one in (low, high, above, below))
        rows = rows[going]
        if not len(rows):
            break
    return found
