"""The voxels around one marker, painted on a fine grid and blurred exactly: accurate to 0.01 mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.layers import HeadLayers
from sim.phantom.head.shapes import Point, Shape, Values
from sim.phantom.scanner import blur
from sim.phantom.scanner.faults import Kernel
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.painting import paint

HALF_SIDE_MM = 10.0  # estimators use up to 9 mm from the centre
WIDER = 2.0  # width of what a kernel subtracts to enhance edges, relative to what it adds
FINE_MM = 0.2  # largest sample spacing; edges are antialiased on top


@dataclass(frozen=True)
class Patch:
    """Noise-free HU (slices, rows, columns) and their position in the volume."""

    slices: slice
    rows: slice
    columns: slice
    hu: Values


def paint_patch(
    centre: Point,
    shapes: tuple[Shape, ...],
    sharp_head: HeadLayers,
    grid: CtGrid,
    kernel: Kernel,
    thickness_mm: float,
) -> Patch:
    """Paint the surroundings of a marker's centre; `shapes` is everything that may extend into them."""
    where = [
        grid.indices(axis, centre[axis] - HALF_SIDE_MM, centre[axis] + HALF_SIDE_MM) for axis in range(3)
    ]
    voxels = [
        positions[part] for positions, part in zip((grid.x_mm, grid.y_mm, grid.z_mm), where, strict=True)
    ]
    spacing = (grid.pixel_mm, grid.pixel_mm, grid.slice_mm)
    sigma = (kernel.plane_sigma_mm, kernel.plane_sigma_mm, blur.SLICE_SIGMA_MM)
    boxes = (grid.pixel_mm, grid.pixel_mm, thickness_mm)
    wide = WIDER if kernel.enhanced else 1.0
    spreads = [blur.spread_mm(box, wide * g) for box, g in zip(boxes, sigma, strict=True)]
    fine = [_samples(v, s, far) for v, s, far in zip(voxels, spacing, spreads, strict=True)]
    x, y, z = (axis.astype(np.float32) for axis in fine)
    image = sharp_head.at(x[None, None, :], y[None, :, None], z[:, None, None])
    for shape in shapes:
        paint(image, (x, y, z), shape, FINE_MM)
    by_x, by_y, by_z = (
        blur.weights(v, box, f, g) for v, box, f, g in zip(voxels, boxes, fine, sigma, strict=True)
    )
    if kernel.enhanced:
        by_x, by_y = (
            (1.0 + kernel.enhanced) * sharp - kernel.enhanced * blur.weights(v, box, f, WIDER * g)
            for sharp, v, box, f, g in list(zip((by_x, by_y), voxels, boxes, fine, sigma, strict=False))
        )
    # one axis at a time, as plain matrix products
    image = (image.reshape(-1, len(x)) @ by_x.T).reshape(len(z), len(y), -1)
    image = np.ascontiguousarray(image.transpose(0, 2, 1)).reshape(-1, len(y)) @ by_y.T
    image = by_z @ image.reshape(len(z), -1)
    image = image.reshape(len(by_z), len(by_x), len(by_y)).transpose(0, 2, 1)
    return Patch(slices=where[2], rows=where[1], columns=where[0], hu=np.ascontiguousarray(image))


def _samples(voxels: NDArray[np.float64], spacing: float, spread: float) -> NDArray[np.float64]:
    """Fine positions around a row of voxels, a whole number of them per voxel."""
    per_voxel = int(np.ceil(spacing / FINE_MM))
    step = spacing / per_voxel
    outside = int(np.ceil((spread - 0.5 * spacing) / step))
    count = len(voxels) * per_voxel + 2 * outside
    samples: NDArray[np.float64] = voxels[0] - 0.5 * spacing + step * (np.arange(count) - outside + 0.5)
    return samples
