"""Thinning of a scan to points of equal spacing, in an order that does not depend on that of the scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arrays import Array

MOST_POINTS = 300  # more say little more: neighbours share their misfit; the cost grows with the cube
FIRST_SPACING_MM = 3.0
WIDER = 1.1


def thin_points(points_mm: Array, most: int = MOST_POINTS) -> tuple[NDArray[np.int64], float]:
    """Return the rows of about equally spaced points, in order of their place, and their spacing in mm.

    Of all points in a cell of the grid, the one nearest to their mean is kept.
    """
    order = np.lexsort(points_mm.T)
    points = points_mm[order]
    spacing_mm = FIRST_SPACING_MM
    while True:
        _, cell = np.unique(np.floor(points / spacing_mm).astype(int), axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        if cell.max() < most:
            break
        spacing_mm *= WIDER
    counts = np.bincount(cell)
    mean = np.column_stack([np.bincount(cell, one) for one in points.T]) / counts[:, None]
    distance = np.linalg.norm(points - mean[cell], axis=1)
    by_cell = np.lexsort((distance, cell))  # stable: equal distances keep the order of places
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return order[np.sort(by_cell[first])], spacing_mm
