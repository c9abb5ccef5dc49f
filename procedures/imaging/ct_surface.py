"""Surface of skin or bone in a CT, by grey values at sub-voxel.

The surface is where the grey value is half way between what is inside and what is outside, both taken at the
place itself: fat under the skin or foam against it move a fixed threshold by tenths of a millimetre. It is
read from a cubic spline, along the surface's normal, at each place that is asked for: there is no mesh.
Which parts are no good as a surface is said with a reason.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from procedures.imaging.ct_body import COARSE_MM, FINE_MM, GreyGrid, find_body
from procedures.imaging.errors import NO_SURFACE
from procedures.imaging.volume import OUTSIDE_FIELD_HU, Volume
from ronna_hw.arrays import Array, Mask

SAMPLES_MM = 2.5  # between the samples of the surface
INSIDE_MM, OUTSIDE_MM = (1.0, 3.0), (2.0, 3.5)  # from the surface, where tissue and its outside are read
PLATEAU = 3  # steps of a profile that are averaged against noise
REACH_MM = 6.0  # of a profile to either side
STEP_MM = 0.25  # of a profile: below half of a voxel
SEARCH_MM = 2.5  # from where the nearest sample expects the surface
EDGE_MM = 4.0  # from the faces of the scan
SLOPE_MM = 0.75  # half base of the differences for a normal
NEIGHBOURS = 8


class Reason(StrEnum):
    """Reasons for which a part of the boundary is no surface to register to."""

    EDGE = "edge of the scan"
    COVERED = "no free space in front: headrest, hair, or an ear folded against it"
    FOREIGN = "not this tissue: metal, plastic, a cable"
    THIN = "thin: hair, tape, a cable"
    UNCLEAR = "no clear edge"
    SMALL = "small patch between excluded ones"


@dataclass(frozen=True)
class Tissue:
    """Tissue whose surface is looked for, by grey values in HU."""

    name: str
    threshold_hu: float  # of the body
    inside_hu: tuple[float, float]  # accepted just inside
    outside_hu: float  # largest just outside
    clipped_hu: tuple[float, float]  # beyond, values say nothing about this surface


SKIN = Tissue("skin", -500.0, (-250.0, 350.0), -850.0, (-1000.0, 300.0))
BONE = Tissue("bone", 300.0, (350.0, 2500.0), 250.0, (-150.0, 2500.0))


@dataclass(frozen=True)
class ExcludedPart:
    """Part of the boundary that is no surface to register to, by its reason, its share, and its middle."""

    reason: Reason
    share: float
    middle_ct_mm: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class CtSurface:
    """Surface in the CT frame: samples (m, 3), outward normals and levels, and what was excluded.

    All boundary samples are kept: a place nearest to an excluded one is not valid.
    """

    tissue: Tissue
    boundary_mm: Array
    directions: Array
    levels_hu: Array
    is_surface: Mask
    excluded: tuple[ExcludedPart, ...]
    spline: NDArray[np.float32] = field(repr=False)
    grid: GreyGrid = field(repr=False)
    tree: cKDTree = field(repr=False)

    @property
    def points_mm(self) -> Array:
        """Samples (m, 3) of the surface."""
        return np.asarray(self.boundary_mm[self.is_surface])

    @property
    def normals(self) -> Array:
        """Outward unit normals (m, 3) of the samples."""
        return np.asarray(self.directions[self.is_surface])

    @property
    def voxel_mm(self) -> Array:
        """Edges (3, 3) of the voxels, as rows."""
        return np.asarray((self.grid.geometry.axes * self.grid.geometry.spacing_mm).T)

    def residuals(self, points_ct_mm: Array) -> tuple[Array, Array, Mask]:
        """Return signed distances (n,) along the normals (n, 3), positive outside, and which are valid."""
        _, nearest = self.tree.query(points_ct_mm)
        direction = self.directions[nearest]
        expected = np.einsum("ni,ni->n", points_ct_mm - self.boundary_mm[nearest], direction)
        foot = points_ct_mm - expected[:, None] * direction
        steps = np.arange(-SEARCH_MM, SEARCH_MM + STEP_MM, STEP_MM)
        profile = sample(self.grid, self.spline, foot[:, None] + steps[:, None] * direction[:, None])
        crossing, is_clear = find_crossing(profile, steps, self.levels_hu[nearest])
        crossing = np.where(is_clear, crossing, 0.0)
        edge = foot + crossing[:, None] * direction
        normal = find_normals(self.grid, self.spline, edge, direction)
        distance = np.einsum("ni,ni->n", points_ct_mm - edge, normal)
        return distance, normal, self.is_surface[nearest] & is_clear


def find_skin(volume: Volume) -> CtSurface:
    """Find the skin. Raises CT-028 if there is no head."""
    return find_surface(volume, SKIN)


def find_bone(volume: Volume) -> CtSurface:
    """Find the outer surface of the skull, for bone that is exposed or drilled. Raises CT-028."""
    return find_surface(volume, BONE)


def find_surface(volume: Volume, tissue: Tissue) -> CtSurface:
    """Find the surface of the largest body of a tissue. Raises CT-028."""
    body = find_body(GreyGrid.of(volume, COARSE_MM, *tissue.clipped_hu), tissue.threshold_hu)
    if body is None:
        raise NO_SURFACE(f"the CT shows no {tissue.name}", limit=f"above {tissue.threshold_hu:g} HU")
    grid = GreyGrid.of(volume, FINE_MM, *tissue.clipped_hu)
    spline = ndimage.spline_filter(grid.values, order=3, output=np.float32, mode="mirror")
    rows = _thin(body.places_mm)
    places, directions = body.places_mm[rows], body.outwards[rows]
    steps = np.arange(-REACH_MM, REACH_MM + STEP_MM, STEP_MM)
    for _ in range(2):  # the second time along the surface's own normal
        profile = sample(grid, spline, places[:, None] + steps[:, None] * directions[:, None])
        middle, _ = find_crossing(profile, steps, np.full(len(places), tissue.threshold_hu))
        inside, outside, deepest = _read_sides(profile, steps, middle)
        levels = 0.5 * (inside + outside)
        crossing, is_clear = find_crossing(profile, steps, levels)
        shift = np.where(is_clear, crossing, 0.0)
        places = places + shift[:, None] * directions
        directions = find_normals(grid, spline, places, directions)
    reason = np.select(
        [
            _near_faces(volume, places),
            ~is_clear | ~np.isfinite(levels),
            outside > tissue.outside_hu,
            (inside < tissue.inside_hu[0]) | (inside > tissue.inside_hu[1]),
            deepest < tissue.threshold_hu,
        ],
        [Reason.EDGE, Reason.UNCLEAR, Reason.COVERED, Reason.FOREIGN, Reason.THIN],
        "",
    )
    tree = cKDTree(places)
    reason = np.where(_is_lone(tree, places, reason == "") & (reason == ""), Reason.SMALL, reason)
    is_surface = reason == ""
    if not is_surface.any():
        raise NO_SURFACE(
            f"no part of the {tissue.name} is free", got=f"{body.volume_cm3:.0f} cm3 in one piece"
        )
    excluded = tuple(
        ExcludedPart(one, float(np.mean(reason == one)), tuple(places[reason == one].mean(axis=0).tolist()))
        for one in Reason
        if np.any(reason == one)
    )
    levels = np.where(np.isfinite(levels), levels, tissue.threshold_hu)
    return CtSurface(tissue, places, directions, levels, is_surface, excluded, spline, grid, tree)


def sample(grid: GreyGrid, spline: NDArray[np.float32], places_mm: Array) -> Array:
    """Interpolate grey values at places (..., 3) mm from the coefficients of a cubic spline."""
    index = np.moveaxis(grid.geometry.to_index(places_mm), -1, 0)
    return np.asarray(
        ndimage.map_coordinates(spline, index, order=3, mode="nearest", prefilter=False), dtype=float
    )


def find_crossing(profile: Array, steps: Array, levels: Array) -> tuple[Array, Mask]:
    """Return where profiles (n, k) outwards fall through their levels (n,), nearest to the middle."""
    above = profile >= levels[:, None]
    falls = above[:, :-1] & ~above[:, 1:]
    distance = np.where(falls, np.abs(steps[:-1] + 0.5 * (steps[1] - steps[0])), np.inf)
    row, first = np.arange(len(profile)), distance.argmin(axis=1)
    before, after = profile[row, first], profile[row, first + 1]
    is_clear = falls[row, first]
    drop = np.where(is_clear, before - after, 1.0)
    return steps[first] + (before - levels) / drop * (steps[1] - steps[0]), is_clear


def find_normals(grid: GreyGrid, spline: NDArray[np.float32], places_mm: Array, otherwise: Array) -> Array:
    """Return unit normals (n, 3) against the gradient; where there is none, the other direction."""
    ends = SLOPE_MM * np.eye(3)
    slope = np.stack(
        [sample(grid, spline, places_mm - one) - sample(grid, spline, places_mm + one) for one in ends],
        axis=-1,
    )
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    unit = slope / np.where(length > 0.0, length, 1.0)
    return np.where(np.einsum("ni,ni->n", unit, otherwise)[:, None] > 0.0, unit, otherwise)


def _read_sides(profile: Array, steps: Array, middle: Array) -> tuple[Array, Array, Array]:
    """Return the value inside, that outside, and the least inside, (n,) each; NaN where there is none.

    Inside it is the peak: skin and the outer table are thin, and beneath them are fat and diploe.
    """
    from_edge = steps - middle[:, None]
    is_inside = (-from_edge >= INSIDE_MM[0]) & (-from_edge <= INSIDE_MM[1])
    is_outside = (from_edge >= OUTSIDE_MM[0]) & (from_edge <= OUTSIDE_MM[1])
    smooth = ndimage.uniform_filter1d(profile, PLATEAU, axis=1)
    inside = np.max(smooth, axis=1, where=is_inside, initial=-np.inf)
    least = np.min(profile, axis=1, where=is_inside, initial=np.inf)
    outside = np.sum(profile, axis=1, where=is_outside) / np.maximum(is_outside.sum(axis=1), 1)
    known = is_inside.any(axis=1) & is_outside.any(axis=1)
    return np.where(known, inside, np.nan), np.where(known, outside, np.nan), np.where(known, least, np.nan)


def _thin(places_mm: Array) -> NDArray[np.int64]:
    _, rows = np.unique(np.floor(places_mm / SAMPLES_MM).astype(int), axis=0, return_index=True)
    return np.sort(rows)


def _near_faces(volume: Volume, places_mm: Array) -> Mask:
    """Mark places near the faces of the scan or its round field."""
    geometry = volume.geometry
    index = geometry.to_index(places_mm)
    margin = EDGE_MM / geometry.spacing_mm
    last = np.array(geometry.shape) - 1.0
    near = np.any((index < margin) | (index > last - margin), axis=1)
    offsets = EDGE_MM * np.vstack([np.eye(3), -np.eye(3)])
    around = volume.sample(places_mm[:, None] + offsets, OUTSIDE_FIELD_HU - 1.0)
    return np.asarray(near | (around.min(axis=1) < OUTSIDE_FIELD_HU))


def _is_lone(tree: cKDTree, places_mm: Array, kept: Mask) -> Mask:
    """Mark places that have few kept ones around them."""
    _, near = tree.query(places_mm, k=NEIGHBOURS)
    return np.asarray(kept[near].mean(axis=1) < 0.5)
