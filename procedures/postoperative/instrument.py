"""Detection of an electrode or needle near a planned trajectory, as a metal rod with axis and tip.

A coarse pass takes the longest bright piece along the trajectory; then a blurred rod is fitted to the voxels
around it, and then again with its streaks, which would otherwise shift the depth of the tip by tenths of a
millimetre. Scanners clip stored values, so the rod's own intensity is fitted and clipped alike.

Metal throws rays into the plane of each slice. A straight rod crosses the slices alike, so they show the same
rays about it: the pattern is read along the shaft. Where the tip fills a slice only in part, the pattern's
strength and its origin along the rod are unknown, two numbers for each such slice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import RigidTransform
from scipy.special import chndtr, erfc

from procedures.imaging.volume import Volume
from procedures.postoperative.bone_registration import sample_bone
from procedures.postoperative.planned_line import (
    SLAB_MM,
    ExpectedFit,
    FitQuality,
    FittedAxis,
    PlannedLine,
    mark_at_bound,
    sample_along,
    select_voxels,
)
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import cauchy_weights, robust_sigma

Numbers = NDArray[np.int64]

HARMONICS = 8  # of the angle about the rod: up to so many bright rays
COLUMNS = 2 * 2 * HARMONICS  # sine and cosine, constant and linear in the distance from the rod
LEAST_VOXELS = 5 * COLUMNS  # to determine them
LEAST_STEEP = 0.3  # sine of the angle between rod and slices: a flatter rod crosses too few
PART_MM = 0.5  # reach of blurred metal beyond the slice itself, along the rod
HALF_STRENGTH = 0.5
ALONG_MM = 1.5  # uncertainty of the origin of a slice's streaks along the rod, either way
MOST_STRENGTH = 1.5
REWEIGHTED = 3

METAL_HU = 1000.0  # by which metal is brighter than the tissue before, compact bone included
OUTSIDE_MM, BEYOND_MM = 20.0, 15.0  # of entry and target: the search range
LEAST_LENGTH_MM = 15.0  # in one piece along the trajectory; anything shorter is no instrument
AROUND_MM = 3.5  # voxels within this distance of the axis are fitted
RING_MM = (2.6, 3.5)  # the background around it, slab by slab
BEYOND_TIP_MM = 6.0
FITTED_LENGTH_MM = 60.0  # from the tip outwards; a longer one may be bent
FIRST_RADIUS_MM, FIRST_SPREAD_MM = 0.6, 0.45
VOXEL_SAMPLES = (2, 2, 3)  # along columns, rows and slices: a voxel is the mean over its volume
PROFILE_STEP_MM = 0.05
SATURATED = 0.99  # of the largest stored value
LEAST_SCALE_HU = 30.0  # of noise, for the robust loss
MOST_PIECES = 4  # of metal examined per trajectory
PLACED, ROD = 5, 8  # numbers of fitted parameters that give the position, and of all the rod's
MOST_PASSES = 10  # with streaks: tip and streaks are each read better with the other known
STILL_MM = 0.005  # a smaller change by a pass says that they agree
# streaks that are not fitted, and clipping, leave up to 300 HU; from the thinnest lead to the thickest needle
USUAL_ROD = ExpectedFit(residual_hu=450.0, radius_mm=(0.3, 1.4))


def find_rods(
    pre: Volume, post: Volume, line: PlannedLine, post_from_pre: RigidTransform
) -> tuple[FittedAxis, ...]:
    """Find rods near a planned trajectory of the first scan, longest first.

    Positions are in the second scan's coordinates.
    """
    post_line = line.apply_pose(post_from_pre)
    seen = sample_along(post, post_line, -OUTSIDE_MM, line.length_mm + BEYOND_MM)
    before = sample_bone(pre, post_from_pre.inv().apply(post_line.to_patient_mm(seen.places_mm)))
    labels, count = ndimage.label(seen.values - before > METAL_HU, structure=np.ones((3, 3, 3)))
    pieces = [seen.places_mm[labels == number] for number in range(1, count + 1)]
    long = [places for places in pieces if _length_mm(places) >= LEAST_LENGTH_MM]
    longest = sorted(long, key=_length_mm, reverse=True)[:MOST_PIECES]
    return tuple(_fit_rod(post, _fit_coarse_line(post_line, places)) for places in longest)


def _length_mm(places: Array) -> float:
    return float(np.ptp(places[:, 0]))


def _fit_coarse_line(line: PlannedLine, places: Array) -> PlannedLine:
    """Fit a line to a bright component at `places` (n, 3), along and across the trajectory in mm."""
    slope = np.polyfit(places[:, 0], places[:, 1:], 1)
    ends = np.array([places[:, 0].min(), places[:, 0].max()])
    rod = np.column_stack([ends, np.outer(ends, slope[0]) + slope[1]])
    outer, inner = line.to_patient_mm(rod)
    return PlannedLine(outer, inner)


def _fit_rod(volume: Volume, coarse: PlannedLine) -> FittedAxis:
    """Fit a blurred rod to the voxels, starting from a coarse line that ends at the tip."""
    outside_mm = min(FITTED_LENGTH_MM, coarse.length_mm)
    between_mm = coarse.length_mm - outside_mm, coarse.length_mm + BEYOND_TIP_MM
    local, values = select_voxels(volume, coarse, between_mm, AROUND_MM)
    local[:, 0] -= coarse.length_mm  # from the coarse tip, inwards
    scanned = np.isfinite(values)
    is_whole = bool(scanned[local[:, 0] > 0.0].all())  # no tip is where only the scan ends
    local, values = local[scanned], values[scanned]
    ceiling = SATURATED * float(volume.voxels.max())
    values = np.minimum(values, ceiling)
    turned = coarse.axes.T @ volume.geometry.axes
    slices = Slices(local, turned[:, 0], turned[:, 1:], float(volume.geometry.spacing_mm[0]))
    samples = local + _voxel_offsets(volume, coarse)[:, None, :]
    # offsets at the tip and at the outer end, tip depth, intensity, radius, blur
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * ceiling, FIRST_RADIUS_MM, FIRST_SPREAD_MM])
    low = np.array([-3.0, -3.0, -3.0, -3.0, -5.0, 0.3 * ceiling, 0.2, 0.2])
    high = np.array([3.0, 3.0, 3.0, 3.0, 5.0, 20.0 * ceiling, 2.0, 1.0])
    initial_streaks = zero_streaks(slices, _rod_axis(start, outside_mm))
    model = _VoxelModel(samples, outside_mm, ceiling, _estimate_background(local, values), initial_streaks)
    found = model.fit(values, start, (low, high), LEAST_SCALE_HU * 3)
    for _ in range(MOST_PASSES):
        placed = found.x[:PLACED]
        rod_hu = model.without_streaks(found.x)
        usable = (values < ceiling) & (rod_hu < ceiling)
        streaks = read_streaks(slices, _rod_axis(found.x, outside_mm), values - rod_hu, usable)
        background = _estimate_background(local, values - streaks.hu(streaks.start))
        model = replace(model, background=background, streaks=streaks)
        bounds = np.concatenate([low, streaks.low]), np.concatenate([high, streaks.high])
        begin = np.concatenate([found.x[:ROD], streaks.start])
        scale = max(LEAST_SCALE_HU, robust_sigma(model.hu(begin) - values))
        found = model.fit(values, begin, bounds, 2.0 * scale)
        if np.abs(found.x[:PLACED] - placed).max() < STILL_MM:
            break
    tip_u, tip_v, end_u, end_v, depth_mm = found.x[:PLACED]
    share = depth_mm / outside_mm  # the line continues beyond the coarse tip
    at_tip = [coarse.length_mm + depth_mm, tip_u + share * (tip_u - end_u), tip_v + share * (tip_v - end_v)]
    outer, tip = coarse.to_patient_mm(np.array([[coarse.length_mm - outside_mm, end_u, end_v], at_tip]))
    outwards = (outer - tip) / np.linalg.norm(outer - tip)
    quality = FitQuality(
        is_whole,
        found.success,
        not mark_at_bound(found.x[:ROD], low, high)[:PLACED].any(),
        robust_sigma(model.hu(found.x) - values),
        float(found.x[6]),
    )
    return FittedAxis(tip, outwards, quality)


@dataclass(frozen=True, eq=False)
class _VoxelModel:
    """Model of the voxels around a rod: tissue, rod and streaks, clipped like the scanner's output."""

    samples: Array
    length_mm: float
    ceiling: float
    background: Array
    streaks: Streaks

    def without_streaks(self, unknown: Array) -> Array:
        """Return the HU of tissue and rod, without clipping."""
        shape = _rod_share(self.samples, unknown[:ROD], self.length_mm).mean(axis=0)
        return np.asarray(self.background + (unknown[PLACED] - self.background) * shape)

    def hu(self, unknown: Array) -> Array:
        """Return the clipped HU of tissue, rod and streaks. The rod's parameters come first in `unknown`."""
        return np.minimum(self.without_streaks(unknown) + self.streaks.hu(unknown[ROD:]), self.ceiling)

    def fit(
        self, values: Array, start: Array, bounds: tuple[Array, Array], scale_hu: float
    ) -> OptimizeResult:
        """Fit the parameters to the voxels' HU."""
        return least_squares(
            lambda unknown: self.hu(unknown) - values, start, bounds=bounds, loss="soft_l1", f_scale=scale_hu
        )


def _rod_axis(unknown: Array, length_mm: float) -> RodAxis:
    """Return the axis of the rod, measured outwards from the coarse tip."""
    tip_u, tip_v, end_u, end_v, depth_mm = unknown[:PLACED]
    outwards = np.array([-length_mm, end_u - tip_u, end_v - tip_v]) / length_mm
    return RodAxis(np.array([0.0, tip_u, tip_v]), outwards, -float(depth_mm))


def _rod_share(local: Array, unknown: Array, length_mm: float) -> Array:
    """Return the rod's fraction at positions (..., 3): a blurred disc across, a blurred edge along."""
    tip_u, tip_v, end_u, end_v, depth_mm, _, radius_mm, spread_mm = unknown
    share = -local[..., 0] / length_mm  # 0 at the coarse tip, 1 at the outer end
    u = local[..., 1] - tip_u - share * (end_u - tip_u)
    v = local[..., 2] - tip_v - share * (end_v - tip_v)
    distances = np.arange(0.0, AROUND_MM + 5.0, PROFILE_STEP_MM)
    # the part of a planar Gaussian within a circle is a noncentral chi-square with two degrees of freedom
    profile = chndtr((radius_mm / spread_mm) ** 2, 2.0, (distances / spread_mm) ** 2)
    across = np.interp(np.hypot(u, v), distances, profile)
    return np.asarray(across * 0.5 * erfc((local[..., 0] - depth_mm) / (np.sqrt(2.0) * spread_mm)))


def _voxel_offsets(volume: Volume, line: PlannedLine) -> Array:
    """Return sample positions (n, 3) in mm relative to a voxel's centre, along and across the line."""
    geometry = volume.geometry
    shares = [(np.arange(count) + 0.5) / count - 0.5 for count in reversed(VOXEL_SAMPLES)]
    grid = np.stack(np.meshgrid(*shares, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(geometry.directions_to_patient(grid * geometry.spacing_mm) @ line.axes)


def _estimate_background(local: Array, values: Array) -> Array:
    """Estimate the background HU of each voxel from medians over a ring around the rod, slab by slab."""
    radius = np.hypot(local[:, 1], local[:, 2])
    ring = (radius > RING_MM[0]) & (radius < RING_MM[1])
    slab = np.floor((local[:, 0] - local[:, 0].min()) / SLAB_MM).astype(int)
    usual = float(np.median(values[ring])) if ring.any() else 0.0
    levels = np.full(slab.max() + 1, usual)
    for number in np.unique(slab[ring]):
        levels[number] = np.median(values[ring & (slab == number)])
    return np.asarray(levels[slab])


@dataclass(frozen=True, eq=False)
class Slices:
    """Voxels (n, 3) mm grouped by slice, with unit vectors `normal` (3,) and `plane` (3, 2)."""

    voxels: Array
    normal: Array
    plane: Array
    slice_mm: float

    @cached_property
    def numbers(self) -> Numbers:
        """Slice number of each voxel, from 0."""
        heights = self.voxels @ self.normal
        return np.asarray(np.rint((heights - heights.min()) / self.slice_mm), dtype=np.int64)

    @cached_property
    def heights_mm(self) -> Array:
        """Height of each slice along the normal."""
        lowest = float((self.voxels @ self.normal).min())
        return lowest + self.slice_mm * np.arange(self.numbers.max() + 1)


@dataclass(frozen=True, eq=False)
class RodAxis:
    """Axis of a rod: a point (3,) mm, the outward direction (3,) per mm, and the tip's position along it."""

    point_mm: Array
    outwards: Array
    tip_mm: float


@dataclass(frozen=True, eq=False)
class Streaks:
    """Streak HU at each voxel: known in the shaft's slices, to be fitted in those of the tip.

    `parts` are the voxels of the latter, slice by slice; each has two unknowns, with `start` and bounds.
    """

    shaft_hu: Array
    pattern: Array
    rod: RodAxis
    slices: Slices
    parts: tuple[Numbers, ...]
    start: Array
    low: Array
    high: Array

    def hu(self, unknown: Array) -> Array:
        """Return the streak HU at each voxel, given strength and axial position in mm for each tip slice."""
        found = self.shaft_hu.copy()
        for part, (strength, along_mm) in zip(self.parts, unknown.reshape(-1, 2), strict=True):
            found[part] = strength * (_harmonics(self.slices, self.rod, along_mm, part) @ self.pattern)
        return found


def zero_streaks(slices: Slices, rod: RodAxis) -> Streaks:
    """Return streaks that are zero everywhere."""
    empty = np.zeros(0)
    return Streaks(np.zeros(len(slices.voxels)), empty, rod, slices, (), empty, empty, empty)


def read_streaks(slices: Slices, rod: RodAxis, rest_hu: Array, usable: Mask) -> Streaks:
    """Estimate the streak pattern from usable shaft voxels (n,), given HU with rod and tissue subtracted."""
    steep = float(rod.outwards @ slices.normal)
    if abs(steep) < LEAST_STEEP * float(np.linalg.norm(rod.outwards)):
        return zero_streaks(slices, rod)
    middles_mm = (slices.heights_mm - float(rod.point_mm @ slices.normal)) / steep  # along the rod
    half_mm = 0.5 * slices.slice_mm / abs(steep)
    is_whole = middles_mm - half_mm > rod.tip_mm + PART_MM
    in_shaft = is_whole[slices.numbers]
    shaft_voxels = np.flatnonzero(in_shaft & usable)
    if len(shaft_voxels) < LEAST_VOXELS:
        return zero_streaks(slices, rod)
    everywhere = np.arange(len(slices.voxels))
    columns = _harmonics(slices, rod, middles_mm[slices.numbers], everywhere)
    pattern = _solve_robustly(columns[shaft_voxels], rest_hu[shaft_voxels])
    tip_slices = np.flatnonzero(~is_whole & (middles_mm + half_mm > rod.tip_mm - PART_MM))
    inner_mm = np.maximum(middles_mm[tip_slices] - half_mm, rod.tip_mm)
    outer_mm = np.maximum(middles_mm[tip_slices] + half_mm, rod.tip_mm)
    start = np.column_stack([np.full(len(tip_slices), HALF_STRENGTH), 0.5 * (inner_mm + outer_mm)])
    return Streaks(
        np.where(in_shaft, columns @ pattern, 0.0),
        pattern,
        rod,
        slices,
        tuple(np.flatnonzero(slices.numbers == number) for number in tip_slices),
        start.ravel(),
        (start * [0.0, 1.0] - [0.0, ALONG_MM]).ravel(),
        (start * [0.0, 1.0] + [MOST_STRENGTH, ALONG_MM]).ravel(),
    )


def _harmonics(slices: Slices, rod: RodAxis, along_mm: Array | float, voxels: Numbers) -> Array:
    """Return the harmonic basis (n, COLUMNS) at voxels around the axis points at `along_mm`."""
    centres = rod.point_mm + np.reshape(along_mm, (-1, 1)) * rod.outwards
    across = (slices.voxels[voxels] - centres) @ slices.plane
    angles = np.arctan2(across[:, 1], across[:, 0])[:, None] * np.arange(1, HARMONICS + 1)
    turns = np.hstack([np.cos(angles), np.sin(angles)])
    return np.hstack([turns, turns * np.linalg.norm(across, axis=1, keepdims=True)])


def _solve_robustly(columns: Array, values: Array) -> Array:
    """Solve a least-squares problem with Cauchy weights."""
    weights = np.ones(len(values))
    for _ in range(REWEIGHTED):
        root = np.sqrt(weights)
        solved = np.linalg.lstsq(columns * root[:, None], values * root, rcond=None)[0]
        residuals = values - columns @ solved
        weights = cauchy_weights(residuals, robust_sigma(residuals) + 1.0)
    return np.asarray(solved, dtype=float)
