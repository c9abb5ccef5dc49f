"""Markers and thin rods painted on a fine grid and blurred exactly, to an accuracy of 0.01 mm.

The slice painter gives every edge the same width, which is wrong across a rod thinner than that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.painting import PLANE_SIGMA_MM, SLICE_SIGMA_MM, blur_spread_mm, blur_weights, paint
from sim.phantom.head.shapes import Rod, Shape, Values
from sim.phantom.scanner.faults import Kernel
from sim.phantom.scanner.grid import CtGrid
from sim.world.rigid import Point

HALF_SIDE_MM = 10.0  # estimators use up to 9 mm from the centre
WIDER = 2.0  # width of what a kernel subtracts to enhance edges, relative to what it adds
FINE_MM = 0.2  # largest sample spacing; edges are antialiased on top


class PaintedHead(Protocol):
    """A head's layers without bodies, in any pose."""

    def hu_at(self, x: Values, y: Values, z: Values) -> Values:
        """Return the HU at the given points."""
        ...


@dataclass(frozen=True)
class Patch:
    """Noise-free HU block (slices, rows, columns) with its position in the volume."""

    slices: slice
    rows: slice
    columns: slice
    hu: Values


def paint_patch(
    centre: Point,
    shapes: tuple[Shape, ...],
    sharp_head: PaintedHead,
    grid: CtGrid,
    kernel: Kernel,
    thickness_mm: float,
) -> Patch:
    """Paint the surroundings of a marker's centre, including the parts of `shapes` within."""
    ranges = [
        grid.indices(axis, centre[axis] - HALF_SIDE_MM, centre[axis] + HALF_SIDE_MM) for axis in range(3)
    ]
    voxels = [
        positions[part] for positions, part in zip((grid.x_mm, grid.y_mm, grid.z_mm), ranges, strict=True)
    ]
    spacing = (grid.pixel_mm, grid.pixel_mm, grid.slice_mm)
    sigma = (kernel.plane_sigma_mm, kernel.plane_sigma_mm, SLICE_SIGMA_MM)
    boxes = (grid.pixel_mm, grid.pixel_mm, thickness_mm)
    wide = WIDER if kernel.enhanced else 1.0
    spreads = [blur_spread_mm(box, wide * g) for box, g in zip(boxes, sigma, strict=True)]
    fine = [_sample_positions(v, s, far) for v, s, far in zip(voxels, spacing, spreads, strict=True)]
    x, y, z = (axis.astype(np.float32) for axis in fine)
    image = sharp_head.hu_at(x[None, None, :], y[None, :, None], z[:, None, None])
    for shape in shapes:
        paint(image, (x, y, z), shape, FINE_MM)
    by_x, by_y, by_z = (
        blur_weights(v, box, f, g) for v, box, f, g in zip(voxels, boxes, fine, sigma, strict=True)
    )
    if kernel.enhanced:
        by_x, by_y = (
            (1.0 + kernel.enhanced) * sharp - kernel.enhanced * blur_weights(v, box, f, WIDER * g)
            for sharp, v, box, f, g in list(zip((by_x, by_y), voxels, boxes, fine, sigma, strict=False))
        )
    # one axis at a time, as plain matrix products
    image = (image.reshape(-1, len(x)) @ by_x.T).reshape(len(z), len(y), -1)
    image = np.ascontiguousarray(image.transpose(0, 2, 1)).reshape(-1, len(y)) @ by_y.T
    image = by_z @ image.reshape(len(z), -1)
    image = image.reshape(len(by_z), len(by_x), len(by_y)).transpose(0, 2, 1)
    return Patch(slices=ranges[2], rows=ranges[1], columns=ranges[0], hu=np.ascontiguousarray(image))


def _sample_positions(voxels: NDArray[np.float64], spacing: float, spread: float) -> NDArray[np.float64]:
    """Return fine sample positions around a row of voxels, with a whole number per voxel."""
    per_voxel = int(np.ceil(spacing / FINE_MM))
    step = spacing / per_voxel
    outside = int(np.ceil((spread - 0.5 * spacing) / step))
    count = len(voxels) * per_voxel + 2 * outside
    samples: NDArray[np.float64] = voxels[0] - 0.5 * spacing + step * (np.arange(count) - outside + 0.5)
    return samples


def paint_rod(image: Values, rod: Rod, grid: CtGrid, number: int) -> None:
    """Paint a rod into slice `number`, an array (rows, columns)."""
    z_mm = float(grid.z_mm[number])
    half_mm = blur_spread_mm(grid.slice_mm, SLICE_SIGMA_MM)
    part = part_between(rod, z_mm - half_mm, z_mm + half_mm)
    if part is None:
        return
    spread_mm = blur_spread_mm(grid.pixel_mm, PLANE_SIGMA_MM)
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
    by_x = blur_weights(voxels[0], grid.pixel_mm, fine[0], PLANE_SIGMA_MM)
    by_y = blur_weights(voxels[1], grid.pixel_mm, fine[1], PLANE_SIGMA_MM)
    by_z = blur_weights(voxels[2], grid.slice_mm, fine[2], SLICE_SIGMA_MM)
    cover = by_y @ np.tensordot(by_z[0], inside, axes=1) @ by_x.T
    region = image[rows, columns]
    region += (np.float32(rod.hu) - region) * cover


def middle_at(rod: Rod, z_mm: float, half_mm: float) -> tuple[float, float] | None:
    """Return the centre (x, y) of a rod's part within `half_mm` of a height, or None if there is none."""
    part = part_between(rod, z_mm - half_mm, z_mm + half_mm)
    if part is None:
        return None
    (x0, y0, _), (x1, y1, _) = part
    return 0.5 * (x0 + x1), 0.5 * (y0 + y1)


def part_between(rod: Rod, low_mm: float, high_mm: float) -> tuple[list[float], list[float]] | None:
    """Return the axis ends of a rod clipped between two heights plus its radius, or None if outside."""
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
