"""The streaks of a straight rod, which would otherwise shift the depth of its tip by tenths of a millimetre.

Metal throws rays into the plane of each slice. A straight rod crosses the slices alike, so they show the same
rays about it: the pattern is read along the shaft. Where the tip fills a slice only in part, its strength and
where along the rod it comes from are unknown, two numbers for each such slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ronna_hw.robust_scale import robust_sigma

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

HARMONICS = 8  # of the angle about the rod: up to so many bright rays
COLUMNS = 2 * 2 * HARMONICS  # sine and cosine, constant and linear in the distance from the rod
LEAST_VOXELS = 5 * COLUMNS  # to determine them
LEAST_STEEP = 0.3  # sine of the angle between rod and slices: a flatter rod crosses too few
PART_MM = 0.5  # beyond the slice itself, along the rod: so far metal is blurred into it
HALF_STRENGTH = 0.5
ALONG_MM = 1.5  # by which the place that the streaks of a slice come from is uncertain, either way
MOST_STRENGTH = 1.5
REWEIGHTED = 3
CAUCHY = 2.385


@dataclass(frozen=True, eq=False)
class Slices:
    """Voxels (n, 3) mm and the slices that they belong to: `normal` (3,), `plane` (3, 2) unit vectors."""

    voxels: Array
    normal: Array
    plane: Array
    slice_mm: float

    @cached_property
    def numbers(self) -> Numbers:
        """Of the slice of each voxel, from 0."""
        heights = self.voxels @ self.normal
        return np.asarray(np.rint((heights - heights.min()) / self.slice_mm), dtype=np.int64)

    @cached_property
    def heights_mm(self) -> Array:
        """Of each slice, along the normal."""
        lowest = float((self.voxels @ self.normal).min())
        return lowest + self.slice_mm * np.arange(self.numbers.max() + 1)


@dataclass(frozen=True, eq=False)
class Line:
    """The rod's axis: a point (3,) mm, its way outwards (3,) per mm, and how far along it the tip is."""

    point_mm: Array
    outwards: Array
    tip_mm: float


@dataclass(frozen=True, eq=False)
class Streaks:
    """HU that streaks add to each voxel: known in the slices of the shaft, unknown in those of the tip.

    `parts` are the voxels of the latter, slice by slice; each has two unknowns, with `start` and bounds.
    """

    shaft_hu: Array
    pattern: Array
    line: Line
    slices: Slices
    parts: tuple[Numbers, ...]
    start: Array
    low: Array
    high: Array

    def hu(self, unknown: Array) -> Array:
        """At each voxel, given strength and place along the rod, mm, of each slice of the tip."""
        found = self.shaft_hu.copy()
        for part, (strength, along_mm) in zip(self.parts, unknown.reshape(-1, 2), strict=True):
            found[part] = strength * (_harmonics(self.slices, self.line, along_mm, part) @ self.pattern)
        return found


def no_streaks(slices: Slices, line: Line) -> Streaks:
    """None anywhere."""
    nothing = np.zeros(0)
    return Streaks(np.zeros(len(slices.voxels)), nothing, line, slices, (), nothing, nothing, nothing)


def streaks_along(slices: Slices, line: Line, rest_hu: Array, usable: NDArray[np.bool_]) -> Streaks:
    """The pattern in what a rod without streaks leaves of the usable voxels (n,) along its shaft."""
    steep = float(line.outwards @ slices.normal)
    if abs(steep) < LEAST_STEEP * float(np.linalg.norm(line.outwards)):
        return no_streaks(slices, line)
    middles_mm = (slices.heights_mm - float(line.point_mm @ slices.normal)) / steep  # along the rod
    half_mm = 0.5 * slices.slice_mm / abs(steep)
    whole = middles_mm - half_mm > line.tip_mm + PART_MM
    of_shaft = whole[slices.numbers]
    read = np.flatnonzero(of_shaft & usable)
    if len(read) < LEAST_VOXELS:
        return no_streaks(slices, line)
    everywhere = np.arange(len(slices.voxels))
    columns = _harmonics(slices, line, middles_mm[slices.numbers], everywhere)
    pattern = _robustly_solved(columns[read], rest_hu[read])
    partly = np.flatnonzero(~whole & (middles_mm + half_mm > line.tip_mm - PART_MM))
    inner_mm = np.maximum(middles_mm[partly] - half_mm, line.tip_mm)
    outer_mm = np.maximum(middles_mm[partly] + half_mm, line.tip_mm)
    start = np.column_stack([np.full(len(partly), HALF_STRENGTH), 0.5 * (inner_mm + outer_mm)])
    return Streaks(
        np.where(of_shaft, columns @ pattern, 0.0),
        pattern,
        line,
        slices,
        tuple(np.flatnonzero(slices.numbers == number) for number in partly),
        start.ravel(),
        (start * [0.0, 1.0] - [0.0, ALONG_MM]).ravel(),
        (start * [0.0, 1.0] + [MOST_STRENGTH, ALONG_MM]).ravel(),
    )


def _harmonics(slices: Slices, line: Line, along_mm: Array | float, voxels: Numbers) -> Array:
    """Columns (n, COLUMNS) at voxels, about the points of the axis that far along it."""
    centres = line.point_mm + np.reshape(along_mm, (-1, 1)) * line.outwards
    across = (slices.voxels[voxels] - centres) @ slices.plane
    angles = np.arctan2(across[:, 1], across[:, 0])[:, None] * np.arange(1, HARMONICS + 1)
    turns = np.hstack([np.cos(angles), np.sin(angles)])
    return np.hstack([turns, turns * np.linalg.norm(across, axis=1, keepdims=True)])


def _robustly_solved(columns: Array, values: Array) -> Array:
    """Least squares with Cauchy's weights."""
    weights = np.ones(len(values))
    for _ in range(REWEIGHTED):
        root = np.sqrt(weights)
        solved = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
        left = values - columns @ solved
        weights = 1.0 / (1.0 + (left / (CAUCHY * (robust_sigma(left) + 1.0))) ** 2)
    return np.asarray(solved, dtype=float)
