"""A thin rod as shown by the scanner: on a fine grid, then blurred exactly.

The slice painter gives every edge the same width; across a rod thinner than that this would be wrong.
"""

from __future__ import annotations

import numpy as np

from sim.phantom.head.shapes import Rod, Values
from sim.phantom.scanner import blur
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.painting import paint

FINE_MM = 0.2  # sample spacing; edges are antialiased on top


def paint_rod(image: Values, rod: Rod, grid: CtGrid, number: int) -> None:
    """Paint a rod into slice `number` (rows, columns)."""
    z_mm = float(grid.z_mm[number])
    half_mm = blur.spread_mm(grid.slice_mm, blur.SLICE_SIGMA_MM)
    part = _part_between(rod, z_mm - half_mm, z_mm + half_mm)
    if part is None:
        return
    spread_mm = blur.spread_mm(grid.pixel_mm, blur.PLANE_SIGMA_MM)
    low, high = np.array(part).min(axis=0), np.array(part).max(axis=0)
    columns, rows = (
        grid.indices(axis, low[axis] - rod.radius - spread_mm, high[axis] + rod.radius + spread_mm)
        for axis in (0, 1)
    )
    if columns.start >= columns.stop or rows.start >= rows.stop:
        return
    voxels = (grid.x_mm[columns], grid.y_mm[rows], np.array([z_mm]))
    margins = (spread_mm, spread_mm, half_mm)
    fine = [
        np.arange(v[0] - far, v[-1] + far + FINE_MM / 2, FINE_MM)
        for v, far in zip(voxels, margins, strict=True)
    ]
    x, y, z = (one.astype(np.float32) for one in fine)
    inside = np.zeros((len(z), len(y), len(x)), dtype=np.float32)
    paint(inside, (x, y, z), Rod(1.0, rod.start, rod.along, rod.length, rod.radius), FINE_MM)
    by_x = blur.weights(voxels[0], grid.pixel_mm, fine[0], blur.PLANE_SIGMA_MM)
    by_y = blur.weights(voxels[1], grid.pixel_mm, fine[1], blur.PLANE_SIGMA_MM)
    by_z = blur.weights(voxels[2], grid.slice_mm, fine[2], blur.SLICE_SIGMA_MM)
    cover = by_y @ np.tensordot(by_z[0], inside, axes=1) @ by_x.T
    region = image[rows, columns]
    region += (np.float32(rod.hu) - region) * cover


def middle_at(rod: Rod, z_mm: float, half_mm: float) -> tuple[float, float] | None:
    """Centre (x, y) of the part of a rod within `half_mm` of a height; None if there is none."""
    part = _part_between(rod, z_mm - half_mm, z_mm + half_mm)
    if part is None:
        return None
    (x0, y0, _), (x1, y1, _) = part
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1)


def _part_between(rod: Rod, low_mm: float, high_mm: float) -> tuple[list[float], list[float]] | None:
    """Both ends of the axis between two heights, widened by the rod's radius; None if there is none."""
    start, along = np.array(rod.start), np.array(rod.along)
    margin_mm = rod.radius * float(np.hypot(along[0], along[1]))
    low_mm, high_mm = low_mm - margin_mm, high_mm + margin_mm
    first, last = 0.0, rod.length
    if abs(along[2]) > 1e-9:
        ends = sorted(((low_mm - start[2]) / along[2], (high_mm - start[2]) / along[2]))
        first, last = max(first, ends[0]), min(last, ends[1])
    elif not low_mm <= start[2] <= high_mm:
        return None
    if first > last:
        return None
    return (start + first * along).tolist(), (start + last * along).tolist()
