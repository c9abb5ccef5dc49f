"""Thinning of a scan to points of equal spacing, in an order that does not depend on that of the scan."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median
from scipy.spatial import cKDTree

from procedures.registration.surface.scan import SurfaceScan
from procedures.registration.surface.settling import NEAR_MM, Settled
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import MAD_TO_SIGMA

MOST_POINTS = 240  # more say little more: neighbours share their misfit; the cost grows with the cube
FIRST_SPACING_MM = 3.0
WIDER = 1.1
MEDIAN_VARIANCE = 0.5 * np.pi  # of a median of many normal errors, relative to that of their mean
FEWEST_FOR_SPREAD = 3
TIE_DIGITS = 3  # of mm: two points are as far from their mean, whatever the last bits say

# Hair: neighbours lie in depths up to its thickness, skin does not. Source: parametric heads.
HAIR_REACH_MM, HAIR_NEIGHBOURS = 15.0, 16
FEWEST_IN_LOOK = 8  # neighbours that show by themselves how they scatter
HAIR_APART_MM = 1.0  # of these neighbours: those on one strand say nothing
HAIR_SPREAD_MM, HAIR_NOISES, HAIR_SPREADS = 0.1, 0.5, 2.0  # limit: least, by the noise, by the usual spread
BESIDE_HAIR = 0.75  # of that limit; what neighbours scatter beyond it is noise
ABOVE_QUANTILE, ABOVE_SHARE = 0.84, 1.5  # outwards from the median; relative to that limit


class MergedScan(NamedTuple):
    """Scan with one point for its neighbours, the rows of these points in it, and which of them are hair.

    `far` are rows of points, as far apart, that were left out since they are far from the surface.
    """

    scan: SurfaceScan
    rows: NDArray[np.int64]
    is_hair: Mask
    far: NDArray[np.int64]


def thin_points(points_mm: Array, most: int = MOST_POINTS) -> NDArray[np.int64]:
    """Return the rows of about equally spaced points, in order of their place.

    Of all points in a cell of the grid, the one nearest to their mean is kept.
    """
    order, cell, _ = _cells(points_mm, np.zeros(len(points_mm), dtype=np.int64), most)
    return order[_middles(points_mm[order], cell)]


def merge_neighbours(scan: SurfaceScan, placed: Settled, most: int = MOST_POINTS) -> MergedScan:
    """Merge the points of each look in a cell to one at their median distance from the surface.

    `placed` are all points of the scan near their pose. What a merged point may be off by is stated by its
    neighbours or by their scatter, whichever is more, and by that of a wider neighbourhood which is nearly
    hair. Points far from the surface are left out.
    """
    is_near = placed.valid & (np.abs(placed.distances_mm) < NEAR_MM)
    near, far = np.flatnonzero(is_near), np.flatnonzero(~is_near)
    # In the CT, not in the robot's frame: where the cart stands must not decide which points are merged.
    order, cell, spacing_mm = _cells(placed.places_mm[near], scan.look[near], most)
    ordered = near[order]
    cells = np.arange(cell.max() + 1) if len(cell) else cell
    rows = ordered[_middles(placed.places_mm[ordered], cell)]
    noise_mm2 = scan.noise_along_mm2(placed.directions)
    distances = placed.distances_mm[ordered]
    level = np.asarray(median(distances, cell, cells))
    scatter = MAD_TO_SIGMA * np.asarray(median(np.abs(distances - level[cell]), cell, cells))
    counts = np.bincount(cell)
    several = counts >= FEWEST_FOR_SPREAD
    stated = np.bincount(cell, noise_mm2[ordered]) / counts
    variance = np.where(several, MEDIAN_VARIANCE * np.maximum(stated, scatter**2), stated)
    merged = scan.select(rows)
    moved = (level - placed.distances_mm[rows])[:, None] * placed.directions[rows]
    spread, above, _ = of_all = _spread_in_depth(placed, np.zeros_like(scan.look), near, rows)
    limit = HAIR_SPREAD_MM + HAIR_NOISES * np.sqrt(noise_mm2[rows]) + HAIR_SPREADS * np.median(spread)
    # Two looks at a head that moved between them are no hair: hair scatters within each.
    *of_look, neighbours = _spread_in_depth(placed, scan.look, near, rows)
    spread, above = np.where(neighbours >= FEWEST_IN_LOOK, np.minimum(of_all[:2], of_look), of_all[:2])
    scattered_mm2 = np.maximum(spread**2 - (BESIDE_HAIR * limit) ** 2, 0.0)
    scale = (variance / counts + scattered_mm2) / noise_mm2[rows]
    merged = replace(
        merged,
        points_mm=merged.points_mm + moved,
        covariance_mm2=merged.covariance_mm2 * scale[:, None, None],
    )
    is_hair = (spread > limit) | (above > ABOVE_SHARE * limit)
    apart, beside, _ = _cells(placed.places_mm[far], scan.look[far], len(scan), spacing_mm)
    return MergedScan(merged, rows, is_hair, far[apart[_middles(placed.places_mm[far[apart]], beside)]])


def _spread_in_depth(
    placed: Settled, look: NDArray[np.int64], near: NDArray[np.int64], rows: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Return how the neighbours of the rows scatter in depth, as hair does: both ways, and outwards, mm.

    Neighbours have the same number of `look`. Last is how many there are.
    """
    order, cell, _ = _cells(placed.places_mm[near], look[near], len(near), HAIR_APART_MM)
    apart = near[order[_middles(placed.places_mm[near[order]], cell)]]
    by_look = np.column_stack([placed.places_mm, 2.0 * HAIR_REACH_MM * look])
    distances, count = placed.distances_mm[apart], min(HAIR_NEIGHBOURS, len(apart))
    apart, beside = cKDTree(by_look[apart]).query(by_look[rows], k=[*range(1, count + 1)])
    depth = np.where(apart < HAIR_REACH_MM, distances[beside], np.nan)
    level = np.nanmedian(depth, axis=1)
    spread = MAD_TO_SIGMA * np.nanmedian(np.abs(depth - level[:, None]), axis=1)
    return spread, np.nanquantile(depth, ABOVE_QUANTILE, axis=1) - level, np.isfinite(depth).sum(axis=1)


def _cells(
    points_mm: Array, look: NDArray[np.int64], most: int, spacing_mm: float = FIRST_SPACING_MM
) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Return an order of the points by place, the cell (of one look) of each in that order, and its size.

    The cells are widened until there are few enough.
    """
    order = np.lexsort((look, *points_mm.T))
    points, looks = points_mm[order], look[order]
    while True:
        place = np.column_stack([np.floor(points / spacing_mm).astype(int), looks])
        cell = np.unique(place, axis=0, return_inverse=True)[1].reshape(-1)
        if len(cell) == 0 or cell.max() < most:
            return order, cell, spacing_mm
        spacing_mm *= WIDER


def _middles(points_mm: Array, cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each cell the row of the point nearest to the mean of its points, in order of place."""
    if len(cell) == 0:
        return cell
    counts = np.bincount(cell)
    mean = np.column_stack([np.bincount(cell, one) for one in points_mm.T]) / counts[:, None]
    distance = np.round(np.linalg.norm(points_mm - mean[cell], axis=1), TIE_DIGITS)
    by_cell = np.lexsort((distance, cell))  # stable: equal distances keep the order of places
    return np.asarray(by_cell[np.concatenate([[0], np.cumsum(counts)[:-1]])], dtype=np.int64)
