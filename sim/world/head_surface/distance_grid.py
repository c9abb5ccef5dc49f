"""Grids of distances, with which rays and painters skip empty space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.world.head_surface.blending import Values
from sim.world.rigid import Array, Point, Vectors

SPACING_MM, MISSES_MM = (
    4.0,
    2.5,
)  # of the coarse grid; most that its values miss, at thin parts and in creases
FINE_SPACING_MM, FINE_MISSES_MM = 2.0, 1.0
BAND_MM = 6.0  # to either side of the surface, where the fine grid is exact at its nodes
MOST_STEPS = 60
LEAST_STEP_MM = 0.25

Sampled = Callable[[Values, Values, Values], Values]


@dataclass(frozen=True)
class DistanceGrid:
    """Distances at the nodes of a grid (x, y, z) from `low_mm` on."""

    low_mm: Array
    high_mm: Array
    values: NDArray[np.float32]
    spacing_mm: float = SPACING_MM
    misses_mm: float = MISSES_MM

    @classmethod
    def sample(cls, distance: Sampled, low_mm: Point, high_mm: Point) -> DistanceGrid:
        """Sample a distance between two corners."""
        axes = [
            (low + SPACING_MM * np.arange(int(np.ceil((high - low) / SPACING_MM)) + 1)).astype(np.float32)
            for low, high in zip(low_mm, high_mm, strict=True)
        ]
        x, y, z = axes
        values = np.broadcast_to(
            distance(x[:, None, None], y[None, :, None], z[None, None, :]), [len(one) for one in axes]
        )
        high = np.array([one[-1] for one in axes], dtype=float)
        return cls(np.array(low_mm, dtype=float), high, np.ascontiguousarray(values, dtype=np.float32))

    def refine(self, distance: Sampled) -> DistanceGrid:
        """Return a finer grid of the same distance, exact at its nodes near the surface."""
        values = self.values
        for axis in range(3):
            values = _halve_spacing(values, axis)
        near = np.nonzero(np.abs(values) < BAND_MM)
        places = [
            (low + FINE_SPACING_MM * rows).astype(np.float32)
            for low, rows in zip(self.low_mm, near, strict=True)
        ]
        values[near] = distance(*places)
        return DistanceGrid(self.low_mm, self.high_mm, values, FINE_SPACING_MM, FINE_MISSES_MM)

    def at(self, points_mm: Vectors) -> Array:
        """Return trilinear distances (n,), those of the nearest place of the grid for points outside."""
        shape = np.array(self.values.shape)
        place = np.clip((points_mm - self.low_mm) / self.spacing_mm, 0.0, shape - 1.000001)
        first = place.astype(np.intp)
        x, y, z = (place - first).T
        flat = self.values.ravel()
        stride_x, stride_y = int(shape[1] * shape[2]), int(shape[2])
        corner = first[:, 0] * stride_x + first[:, 1] * stride_y + first[:, 2]
        along_z = [
            flat[corner + step] * (1.0 - z) + flat[corner + step + 1] * z
            for step in (0, stride_y, stride_x, stride_x + stride_y)
        ]
        near, far = (along_z[k] * (1.0 - y) + along_z[k + 1] * y for k in (0, 2))
        return np.asarray(near * (1.0 - x) + far * x)

    def nearest(self, x: Values, y: Values, z: Values) -> NDArray[np.float32]:
        """Return the distances at the nodes nearest to points of arrays that broadcast together."""
        places = [
            np.clip(np.rint((value - low) * (1.0 / self.spacing_mm)), 0, count - 1).astype(np.intp)
            for value, low, count in zip((x, y, z), self.low_mm.tolist(), self.values.shape, strict=True)
        ]
        return np.asarray(self.values[tuple(np.broadcast_arrays(*places))])

    def approach(
        self, origins_mm: Vectors, directions: Vectors, furthest_mm: float, outside_mm: float = 0.0
    ) -> tuple[Array, Array]:
        """Return the distances along each ray between which it may meet the surface.

        The first is infinite if the ray meets nothing. Skin may be `outside_mm` outside the sampled surface.
        """
        origins, directions = np.asarray(origins_mm, dtype=float), np.asarray(directions, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore"):
            to_low, to_high = (self.low_mm - origins) / directions, (self.high_mm - origins) / directions
        first, last = np.fmin(to_low, to_high), np.fmax(to_low, to_high)
        enter, leave = np.maximum(np.nanmax(first, axis=1), 0.0), np.nanmin(last, axis=1)
        along = np.where(enter <= np.minimum(leave, furthest_mm), enter, np.inf)
        active = np.flatnonzero(np.isfinite(along))
        for _ in range(MOST_STEPS):
            if not len(active):
                break
            away = (
                self.at(origins[active] + along[active, None] * directions[active])
                - self.misses_mm
                - outside_mm
            )
            active, away = active[away > LEAST_STEP_MM], away[away > LEAST_STEP_MM]
            along[active] += away
            gone = along[active] > leave[active]
            along[active[gone]] = np.inf
            active = active[~gone]
        return along, np.minimum(leave, furthest_mm)


def _halve_spacing(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return values with the mean of each two neighbours between them."""
    along = np.moveaxis(values, axis, 0)
    fine = np.empty((2 * len(along) - 1, *along.shape[1:]), dtype=np.float32)
    fine[::2], fine[1::2] = along, 0.5 * (along[1:] + along[:-1])
    return np.ascontiguousarray(np.moveaxis(fine, 0, axis))
