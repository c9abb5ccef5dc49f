"""First sphere centre estimator: a sphere fitted to edge points along rays from the centre.

Rays are cast in many directions. On each, the edge is where the intensity falls through the midpoint between
polymer and surroundings. A sphere of free radius is fitted to the edge points with Cauchy weights, so that a
post, skin or a neighbour costs rays but does not pull the centre. The radius must be free: film and blur move
the apparent edge, and a fixed radius would turn that into an error of the centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from procedures.imaging.volume import Region
from ronna_hw.arrays import Array, Mask
from ronna_hw.robust_scale import cauchy_weights, robust_sigma

RAYS = 400
SCAN_FROM, SCAN_TO = 0.52, 1.57  # of the nominal radius: 3 to 9 mm for the usual sphere
SCAN_STEPS = 61
INSIDE_TO = 0.75  # of the nominal radius: definitely inside
OUTSIDE_FROM = 1.40  # of the nominal radius: definitely outside
POLYMER_HU = (-300.0, 500.0)
STREAKED_POLYMER_HU = (-600.0, 900.0)  # several strong streaks across a whole sphere shift its level this far
MIN_CONTRAST_HU = 100.0
OPEN_AT_LEAST = 0.1  # share of the rays ending in something darker that end in the open
OPEN_SHARE = 0.6  # of them; with fewer the sphere counts as covered
COVERED_REACH = 0.2  # of the nominal radius
SAME_LEVEL = 0.25  # of the contrast: a ray whose end levels differ more from the usual ones is not used
INLIER = 0.061  # of the nominal radius (0.35 mm): an edge point this close to the sphere is on it
STEP_INSIDE, STEP_OUTSIDE = (0.70, 0.88), (1.15, 1.35)  # of the fitted radius, clear of the blur
EDGE_TO = 1.10  # of the fitted radius: beyond this the edge has been passed
PASSES, REFINING_PASSES = 3, 2  # rays are cast again from each new centre
FIT_STEPS = 12
FIT_DONE_MM = 1e-6
MIN_SCALE_MM = 1e-3
MIN_RAYS = 24


@dataclass(frozen=True, eq=False)
class RadialEdge:
    """Sphere fitted to edge points. Centre and covariance in grid mm (slice, row, column).

    `surface_share` is the fraction of all rays with their edge on the sphere, `unscanned_share` the fraction
    that leave the scanned volume somewhere, `cut_share` the fraction that do so before passing the sphere's
    edge, `coherence` the fraction of rays ending in the open (usually air) with their edge on the sphere.
    `covered_step_hu` is the typical fall in intensity at the sphere's radius along rays that end in something
    else, such as a bandage; 0 if there are none. `seen` (RAYS,) marks the rays that support the sphere.
    `covariance_mm2` treats the rays as independent.
    """

    centre_mm: Array
    radius_mm: float
    covariance_mm2: Array
    surface_share: float
    unscanned_share: float
    cut_share: float
    inside_hu: float
    outside_hu: float
    coherence: float
    covered_step_hu: float
    seen: Mask


@cache
def ray_directions() -> Array:
    """Return unit ray directions (RAYS, 3), nearly uniform on a golden-angle spiral."""
    number = np.arange(RAYS) + 0.5
    height = 1.0 - 2.0 * number / RAYS
    angle_rad = number * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    directions = np.column_stack([height, across * np.sin(angle_rad), across * np.cos(angle_rad)])
    directions.flags.writeable = False
    return directions


def is_polymer(edge: RadialEdge) -> bool:
    """Whether the intensity inside is that of a polymer free of streaks."""
    return POLYMER_HU[0] < edge.inside_hu < POLYMER_HU[1]


def fit_radial_edge(
    region: Region, start_mm: Array, nominal_radius_mm: float, *, refine: bool = False
) -> RadialEdge | None:
    """Fit an edge from a centre accurate to a third of the radius; return None if none is found.

    With `refine` the start is already good, and the volume is interpolated smoothly.
    """
    directions = ray_directions()
    radii_mm = np.linspace(SCAN_FROM, SCAN_TO, SCAN_STEPS) * nominal_radius_mm
    centre_mm = start_mm
    fitted: RadialEdge | None = None
    for _ in range(REFINING_PASSES if refine else PASSES):
        places_mm = centre_mm + radii_mm[None, :, None] * directions[:, None, :]
        profiles = region.sample(places_mm, smooth=refine)
        fitted = _fit_profiles(profiles, centre_mm, directions, radii_mm, nominal_radius_mm)
        if fitted is None or np.linalg.norm(fitted.centre_mm - start_mm) > nominal_radius_mm:
            return None
        centre_mm = fitted.centre_mm
    return fitted


def _fit_profiles(
    profiles: Array, centre_mm: Array, directions: Array, radii_mm: Array, nominal_radius_mm: float
) -> RadialEdge | None:
    scanned = np.isfinite(profiles).all(axis=1)
    if scanned.sum() < MIN_RAYS:
        return None
    rays, directions = profiles[scanned], directions[scanned]
    inner = np.median(rays[:, radii_mm < INSIDE_TO * nominal_radius_mm], axis=1)
    outer = np.median(rays[:, radii_mm > OUTSIDE_FROM * nominal_radius_mm], axis=1)
    inside_hu = float(np.median(inner))
    darker = outer < inside_hu - MIN_CONTRAST_HU
    low_hu, high_hu = STREAKED_POLYMER_HU
    if not low_hu < inside_hu < high_hu or darker.sum() < MIN_RAYS:
        return None
    outside_hu, is_covered = _find_open_level(outer[darker], inside_hu)
    margin_hu = SAME_LEVEL * (inside_hu - outside_hu)
    usable = (np.abs(inner - inside_hu) < margin_hu) & (np.abs(outer - outside_hu) < margin_hu)
    if usable.sum() < MIN_RAYS:
        return None
    level_hu = _level_by_direction(0.5 * (inner + outer), directions, usable)
    edge_mm, is_crossed = _find_crossings(rays, radii_mm, level_hu)
    usable &= is_crossed
    if is_covered:  # rays that cross the cover before they end in the open
        usable &= np.abs(edge_mm - nominal_radius_mm) < COVERED_REACH * nominal_radius_mm
    if usable.sum() < MIN_RAYS:
        return None
    points_mm = centre_mm + edge_mm[usable, None] * directions[usable]
    new_centre_mm, radius_mm, covariance_mm2, residuals_mm = _fit_sphere(points_mm, centre_mm)
    on_sphere = np.abs(residuals_mm) < INLIER * nominal_radius_mm
    ends_open = np.abs(outer - outside_hu) < margin_hu
    seen = np.zeros(len(profiles), dtype=bool)
    seen[np.flatnonzero(scanned)[usable][on_sphere]] = True
    to_edge = profiles[:, radii_mm <= EDGE_TO * radius_mm]
    return RadialEdge(
        centre_mm=new_centre_mm,
        radius_mm=radius_mm,
        covariance_mm2=covariance_mm2,
        surface_share=float(on_sphere.sum()) / len(profiles),
        unscanned_share=1.0 - float(scanned.sum()) / len(profiles),
        cut_share=1.0 - float(np.isfinite(to_edge).all(axis=1).mean()),
        inside_hu=inside_hu,
        outside_hu=outside_hu,
        coherence=float(on_sphere.sum()) / max(float(ends_open.sum()), 1.0),
        covered_step_hu=_measure_covered_step(
            rays[~ends_open & (outer < inside_hu + margin_hu)], radii_mm, radius_mm
        ),
        seen=seen,
    )


def _find_open_level(darker_hu: Array, inside_hu: float) -> tuple[float, bool]:
    """Return the level of the open surroundings, and whether another body covers most of the sphere."""
    least_hu = float(np.quantile(darker_hu, OPEN_AT_LEAST))
    is_open = darker_hu < least_hu + SAME_LEVEL * (inside_hu - least_hu)
    is_covered = bool(is_open.mean() < OPEN_SHARE)
    return float(np.median(darker_hu[is_open] if is_covered else darker_hu)), is_covered


def _measure_covered_step(rays: Array, radii_mm: Array, radius_mm: float) -> float:
    """Return the median fall in HU from just inside to just outside the sphere."""
    share = radii_mm / radius_mm
    inner_hu = rays[:, (share > STEP_INSIDE[0]) & (share < STEP_INSIDE[1])]
    outer_hu = rays[:, (share > STEP_OUTSIDE[0]) & (share < STEP_OUTSIDE[1])]
    if inner_hu.size == 0 or outer_hu.size == 0:  # uncovered, or a radius beyond the scanned range
        return 0.0
    return float(np.median(inner_hu.mean(axis=1) - outer_hu.mean(axis=1)))


def _level_by_direction(middle_hu: Array, directions: Array, usable: Mask) -> Array:
    """Fit each ray's midpoint level: a constant plus the slope that streaks add across the sphere."""
    design = np.column_stack([np.ones(len(directions)), directions])
    solution, *_ = np.linalg.lstsq(design[usable], middle_hu[usable], rcond=None)
    return np.asarray(design @ solution)


def _find_crossings(rays: Array, radii_mm: Array, level_hu: Array) -> tuple[Array, Mask]:
    """Return the first radius at which each ray falls through its level, and whether it does."""
    level_hu = level_hu[:, None]
    falls = (rays[:, :-1] >= level_hu) & (rays[:, 1:] < level_hu)
    first = np.argmax(falls, axis=1)
    rows = np.arange(len(rays))
    before, after = rays[rows, first], rays[rows, first + 1]
    is_crossed = falls[rows, first]
    drop = np.where(is_crossed, before - after, 1.0)
    share = np.where(is_crossed, (before - level_hu[:, 0]) / drop, 0.0)
    return radii_mm[first] + share * (radii_mm[1] - radii_mm[0]), is_crossed


def _fit_sphere(points_mm: Array, start_mm: Array) -> tuple[Array, float, Array, Array]:
    """Fit a sphere with Cauchy weights: centre, radius, covariance of the centre, residuals."""
    centre_mm = start_mm
    radius_mm = float(np.median(np.linalg.norm(points_mm - centre_mm, axis=1)))
    for _ in range(FIT_STEPS):
        offsets = points_mm - centre_mm
        distances = np.linalg.norm(offsets, axis=1)
        residuals = distances - radius_mm
        scale = max(robust_sigma(residuals), MIN_SCALE_MM)
        weights = cauchy_weights(residuals, scale)
        jacobian = np.column_stack([-offsets / distances[:, None], -np.ones(len(offsets))])
        normal = jacobian.T @ (weights[:, None] * jacobian)
        step = np.linalg.solve(normal + 1e-9 * np.eye(4), -jacobian.T @ (weights * residuals))
        centre_mm = centre_mm + step[:3]
        radius_mm += float(step[3])
        if np.abs(step).max() < FIT_DONE_MM:
            break
    residuals = np.linalg.norm(points_mm - centre_mm, axis=1) - radius_mm
    covariance = scale**2 * np.linalg.inv(normal + 1e-9 * np.eye(4))
    return centre_mm, radius_mm, covariance[:3, :3], residuals
