"""Slices of an image that is stretched along any direction about its middle, cut through straight slices."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil

import numpy as np

from sim.phantom.head.shapes import Values
from sim.phantom.scanner.grid import CtGrid
from sim.world.rigid import Point

REACH = 2  # samples to either side, of cubic interpolation


def slices_beyond(grid: CtGrid, stretch: float) -> int:
    """Return how many straight slices are needed beyond either end."""
    if not stretch:
        return 0
    size_mm = np.array([grid.columns, grid.rows, grid.slices]) * _spacing_mm(grid)
    return ceil(0.5 * abs(stretch) * float(np.linalg.norm(size_mm)) / grid.slice_mm) + REACH


def cut_stretched(
    grid: CtGrid, stretch: float, along: Point, number: int, straight: Callable[[int], Values]
) -> Values:
    """Cut slice `number` of the stretched image through `straight` slices, by cubic interpolation."""
    import cv2

    spacing_mm, middle = _spacing_mm(grid), 0.5 * (np.array([grid.columns, grid.rows, grid.slices]) - 1.0)
    direction = np.array(along) / np.linalg.norm(along)
    true_from_shown = np.eye(3) - stretch / (1.0 + stretch) * np.outer(direction, direction)
    row, column = np.indices((grid.rows, grid.columns))
    shown = np.stack([column, row, np.full_like(row, number)], axis=-1) - middle
    places = shown * spacing_mm @ true_from_shown / spacing_mm + middle
    x, y, z = np.moveaxis(places, -1, 0).astype(np.float32)
    image = np.zeros((grid.rows, grid.columns), dtype=np.float32)
    for plane in range(int(np.floor(z.min())) - REACH + 1, int(np.floor(z.max())) + REACH + 1):
        values = cv2.remap(straight(plane), x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        image += _cubic(z - plane) * values
    return image


def _spacing_mm(grid: CtGrid) -> np.ndarray:
    return np.array([grid.pixel_mm, grid.pixel_mm, grid.slice_mm])


def _cubic(distance: Values) -> Values:
    """Return the weight of a sample at this distance, in samples (Keys 1981)."""
    far = np.abs(distance)
    near = (1.5 * far - 2.5) * far * far + 1.0
    tail = ((2.5 - 0.5 * far) * far - 4.0) * far + 2.0
    return np.asarray(np.where(far < 1.0, near, np.where(far < REACH, tail, 0.0)), dtype=np.float32)
