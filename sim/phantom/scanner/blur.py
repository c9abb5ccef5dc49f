"""The scanner's exact blur: from a fine grid to voxels by one matrix per axis.

A voxel is the average, over its box, of the object blurred by a Gaussian. Along each axis the weight of a
fine sample is the Gaussian integrated over the voxel, so the blur costs three matrix products.
"""

from __future__ import annotations

from math import erf, sqrt

import numpy as np
from numpy.typing import NDArray

PLANE_SIGMA_MM = 0.42  # in the slice: 1 mm full width at half maximum
SLICE_SIGMA_MM = 0.35  # along z, before the slice's own thickness
SPREAD_SIGMAS = 4.0
BOX_VARIANCE = 1.0 / 12.0  # of a box of unit width

Matrix = NDArray[np.float32]


def weights(
    voxels_mm: NDArray[np.float64], spacing_mm: float, fine_mm: NDArray[np.float64], sigma_mm: float
) -> Matrix:
    """Weights (voxels, fine samples), each row adding up to 1."""
    edges = (fine_mm[None, :] - voxels_mm[:, None] + 0.5 * spacing_mm) / (sqrt(2.0) * sigma_mm)
    other = (fine_mm[None, :] - voxels_mm[:, None] - 0.5 * spacing_mm) / (sqrt(2.0) * sigma_mm)
    raw = _erf(edges) - _erf(other)
    rows: Matrix = (raw / raw.sum(axis=1, keepdims=True)).astype(np.float32)
    return rows


def spread_mm(spacing_mm: float, sigma_mm: float) -> float:
    """How far outside a voxel's centre the object still affects it."""
    return SPREAD_SIGMAS * sigma_mm + 0.5 * spacing_mm


def edge_sigma_mm(pixel_mm: float, slice_mm: float, plane_sigma_mm: float = PLANE_SIGMA_MM) -> float:
    """Standard deviation of an edge in any direction, between that in the slice and that along z."""
    plane = plane_sigma_mm**2 + BOX_VARIANCE * pixel_mm**2
    along = SLICE_SIGMA_MM**2 + BOX_VARIANCE * slice_mm**2
    return sqrt((2.0 * plane + along) / 3.0)


def _erf(values: NDArray[np.float64]) -> NDArray[np.float64]:
    # values repeat from voxel to voxel, and there are few: not worth importing SciPy
    result: NDArray[np.float64] = np.vectorize(erf, otypes=[float])(values)
    return result
