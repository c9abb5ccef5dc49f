"""Localization of adhesive ring markers on the skin in a CT.

Rings are what sticks out of the closed head: a coarse mask is opened by a ball that fits into the head but
not into a ring. The surface of each candidate is then measured on rays in its own frame: its top along the
skin's normal, its rims along the radius. The centre is that of the hole, at half the ring's thickness.

A ring is soft and follows the skin, so its centre is less certain than that of a sphere, and it moves with
the skin after the CT. Neither the tracker nor the stereo head sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from procedures.imaging.errors import ADHESIVE_COUNT_WRONG
from procedures.imaging.volume import AIR_HU, Volume
from ronna_hw.adhesive_marker import INNER_RADIUS_MM, OUTER_RADIUS_MM, THICKNESS_MM
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import perpendicular_axes
from ronna_hw.robust_scale import robust_sigma
from ronna_hw.vectors import vector3

COARSE_MM = 1.0
BODY_HU = -450.0  # half-way between air and soft matter
OPENING_MM = 6.0  # radius of the ball: wider than the ring's width and thickness
ROUGH_MM = 0.7  # voxels of the skin that stick out only because the grid is coarse
RING_MM3 = float(np.pi * (OUTER_RADIUS_MM**2 - INNER_RADIUS_MM**2) * THICKNESS_MM)
VOLUME_SHARES = (0.3, 1.6)  # of RING_MM3, of a candidate
ANGLES = 48
RADIUS_STEP_MM = 0.5
RADII_MM = np.arange(3.5, 6.6, RADIUS_STEP_MM)  # of the rays along the normal, between the rims
STEP_MM = 0.1
HEIGHTS_MM = np.arange(5.0, -3.0, -STEP_MM)  # of the rays along the normal, from outside
BELOW_TOP_MM = 1.5  # height of the rays along the radius, under the top
MIDDLE_MM = 0.5 * (OUTER_RADIUS_MM + INNER_RADIUS_MM)
OUTWARDS_MM = np.arange(MIDDLE_MM, OUTER_RADIUS_MM + 4.0, STEP_MM)
INWARDS_MM = np.arange(MIDDLE_MM, -1.0, -STEP_MM)
ROUNDS = 4
RADIUS_TOLERANCE_MM = 1.2  # of both rims: the edge moves with the density of the ring
LEAST_RAYS = 0.7  # share of the rays that must meet the rim
OUTLIER = 3.0  # robust standard deviations
REJECTIONS = 3  # of outliers: the scatter has settled by then
CORRELATED_MM = 2.0  # along the rim: closer rays see the same noise
LEAST_SIGMA_MM = 0.006  # per direction, of the interpolation between voxels; from seed 3 of the phantom


@dataclass(frozen=True)
class AdhesiveRing:
    """Centre of a ring's hole at half its thickness, and the outward normal, LPS; radii of its rims.

    The covariance (3, 3), mm^2, is that of the rays' scatter. It says nothing about the skin, which carries
    the ring along.
    """

    centre_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    outer_radius_mm: float
    inner_radius_mm: float
    covariance_mm2: Array

    @property
    def sigma_mm(self) -> float:
        """Predicted 3-D error, rms."""
        return float(np.sqrt(np.trace(self.covariance_mm2)))


def localize_adhesives(volume: Volume, expected: int | None = None) -> tuple[AdhesiveRing, ...]:
    """Localize all adhesive rings, from superior to inferior. Raises CT-026 for none or another number."""
    rings = [
        ring
        for centre_mm, normal in find_bumps(volume)
        if (ring := _measure_ring(volume, centre_mm, normal)) is not None
    ]
    rings.sort(key=lambda ring: -ring.centre_mm[2])
    if not rings or expected not in (None, len(rings)):
        raise ADHESIVE_COUNT_WRONG(
            f"{len(rings)} adhesive rings found in the CT",
            expected="at least one" if expected is None else str(expected),
            got=str(len(rings)),
        )
    return tuple(rings)


def find_bumps(volume: Volume) -> list[tuple[Array, Array]]:
    """Find what sticks out of the head and has the volume of a ring: centroids (3,) and normals, LPS mm."""
    spacing = volume.geometry.spacing_mm
    coarse = ndimage.zoom(volume.voxels, spacing / COARSE_MM, order=1, mode="nearest", grid_mode=True)
    step_mm = volume.extent_mm / coarse.shape
    head, corner = _cut_out_head(coarse > BODY_HU)
    opened = _open(head, step_mm)
    labels, count = ndimage.label(head & ~opened)
    if not count:
        return []
    sizes_mm3 = np.bincount(labels.ravel(), minlength=count + 1)[1:] * step_mm.prod()
    low, high = (share * RING_MM3 for share in VOLUME_SHARES)
    boxes = ndimage.find_objects(labels)
    middle = np.array(ndimage.center_of_mass(opened))
    found = []
    for number in np.flatnonzero((sizes_mm3 > low) & (sizes_mm3 < high)):
        box = boxes[number]
        places = np.argwhere(labels[box] == number + 1) + [part.start for part in box]
        grid = places.mean(axis=0)
        # the grid's first voxel is centred half a voxel inside the volume's face
        index = ((grid + corner + 0.5) * step_mm) / spacing - 0.5
        *_, axes = np.linalg.svd((places - grid) * step_mm, full_matrices=False)
        outwards = axes[2] * np.sign(axes[2] @ ((grid - middle) * step_mm))
        found.append((volume.geometry.to_patient_mm(index), volume.geometry.directions_to_patient(outwards)))
    return found


def _cut_out_head(body: Mask) -> tuple[Mask, Array]:
    """Return the largest object, with its cavities closed, and the first voxel of its box."""
    labels, count = ndimage.label(body)
    if not count:
        return np.zeros((1, 1, 1), dtype=bool), np.zeros(3)
    largest = int(np.bincount(labels.ravel())[1:].argmax())
    box = ndimage.find_objects(labels)[largest]
    head = np.pad(ndimage.binary_fill_holes(labels[box] == largest + 1), 1)
    return head, np.array([part.start for part in box]) - 1.0


def _open(head: Mask, step_mm: Array) -> Mask:
    """Open a mask by a ball, which keeps what the ball can reach from inside, and a rim as wide as noise."""
    eroded = ndimage.distance_transform_edt(head, sampling=step_mm) > OPENING_MM
    return np.asarray(ndimage.distance_transform_edt(~eroded, sampling=step_mm) <= OPENING_MM + ROUGH_MM)


def _measure_ring(volume: Volume, centre: Array, normal: Array) -> AdhesiveRing | None:
    """Measure a ring from a rough place, or return None for anything that is no ring."""
    found: AdhesiveRing | None = None
    for _ in range(ROUNDS):
        found = _measure_once(volume, centre, normal)
        if found is None:
            return None
        centre, normal = np.array(found.centre_mm), np.array(found.normal)
    assert found is not None
    outer, inner = found.outer_radius_mm - OUTER_RADIUS_MM, found.inner_radius_mm - INNER_RADIUS_MM
    return found if max(abs(outer), abs(inner)) <= RADIUS_TOLERANCE_MM else None


def _measure_once(volume: Volume, centre: Array, normal: Array) -> AdhesiveRing | None:
    """Measure top and rims on rays from an approximate centre and normal."""
    angles = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    across, along = perpendicular_axes(normal)
    rays = np.outer(np.cos(angles), across) + np.outer(np.sin(angles), along)
    top = _fit_top(volume, centre, rays, normal, angles)
    if top is None:
        return None
    at_axis, slope_across, slope_along, *_ = top.coefficients
    normal = normal - slope_across * across - slope_along * along
    normal = normal / np.linalg.norm(normal)
    heights = _top_design(np.full_like(angles, MIDDLE_MM), angles) @ top.coefficients - BELOW_TOP_MM
    outer = _fit_rim(volume, centre, rays, normal, heights, OUTWARDS_MM)
    inner = _fit_rim(volume, centre, rays, normal, heights, INWARDS_MM)
    if outer is None or inner is None:
        return None
    information = 1.0 / outer.variance + 1.0 / inner.variance
    shift = (outer.centre / outer.variance + inner.centre / inner.variance) / information
    centre = centre + shift[0] * across + shift[1] * along + (at_axis - 0.5 * THICKNESS_MM) * normal
    in_plane, upright = 1.0 / information + LEAST_SIGMA_MM**2, top.variance + LEAST_SIGMA_MM**2
    covariance = in_plane * np.eye(3) + (upright - in_plane) * np.outer(normal, normal)
    return AdhesiveRing(vector3(centre), vector3(normal), outer.radius, inner.radius, covariance)


@dataclass(frozen=True)
class _RobustFit:
    """Linear fit without outliers: solution, mean square of its residuals, inverse of the normal matrix."""

    solution: Array
    scatter_mm2: float
    inverse_normal: Array


@dataclass(frozen=True)
class _Top:
    """Top of a ring over its plane: at the axis, slope (2,), curvatures, and the variance at the axis."""

    coefficients: Array
    variance: float


@dataclass(frozen=True)
class _Rim:
    """Circle in the ring's plane, with the variance of its centre per axis."""

    centre: Array
    radius: float
    variance: float


def _fit_top(volume: Volume, centre: Array, rays: Array, normal: Array, angles: Array) -> _Top | None:
    """Fit the top as a quadratic surface: the ring follows the skin, which curves."""
    radii, turns = np.repeat(RADII_MM, ANGLES), np.tile(angles, len(RADII_MM))
    starts = centre + radii[:, None] * np.tile(rays, (len(RADII_MM), 1))
    heights = _first_edges(volume, starts, np.broadcast_to(normal, starts.shape), HEIGHTS_MM, rising=True)
    fit = _fit_robustly(_top_design(radii, turns), heights)
    if fit is None:
        return None
    ray_mm2 = 2.0 * np.pi * MIDDLE_MM / ANGLES * RADIUS_STEP_MM
    independent = min(1.0, ray_mm2 / CORRELATED_MM**2)
    return _Top(fit.solution, fit.scatter_mm2 / independent * float(fit.inverse_normal[0, 0]))


def _fit_robustly(design: Array, measured_mm: Array) -> _RobustFit | None:
    """Fit `measured_mm` (n,), NaN where nothing was met, without outliers; None with too few rays."""
    kept = np.isfinite(measured_mm)
    for _ in range(REJECTIONS):
        if kept.mean() < LEAST_RAYS:
            return None
        solution, *_ = np.linalg.lstsq(design[kept], measured_mm[kept], rcond=None)
        rest = measured_mm - design @ solution
        sd_mm = max(robust_sigma(rest[kept] - np.median(rest[kept])), 0.5 * STEP_MM)
        kept = np.isfinite(rest) & (np.abs(rest) <= OUTLIER * sd_mm)
    return _RobustFit(
        np.asarray(solution, dtype=float),
        float(np.mean(rest[kept] ** 2)),
        np.asarray(np.linalg.inv(design[kept].T @ design[kept]), dtype=float),
    )


def _top_design(radii: Array, angles: Array) -> Array:
    x, y = radii * np.cos(angles), radii * np.sin(angles)
    return np.column_stack([np.ones_like(x), x, y, x * x + y * y, x * x - y * y, x * y])


def _fit_rim(
    volume: Volume, centre: Array, rays: Array, normal: Array, heights: Array, distances: Array
) -> _Rim | None:
    """Fit a circle to where the rays leave the ring."""
    edges = _first_edges(volume, centre + heights[:, None] * normal, rays, distances, rising=False)
    angles = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    design = np.column_stack([np.cos(angles), np.sin(angles), np.ones(ANGLES)])
    fit = _fit_robustly(design, edges)
    if fit is None:
        return None
    radius_mm = float(fit.solution[2])
    independent = min(1.0, 2.0 * np.pi * abs(radius_mm) / ANGLES / CORRELATED_MM)
    per_axis = 0.5 * float(fit.inverse_normal[0, 0] + fit.inverse_normal[1, 1])
    return _Rim(fit.solution[:2], radius_mm, fit.scatter_mm2 / independent * per_axis)


def _first_edges(volume: Volume, starts: Array, along: Array, distances: Array, *, rising: bool) -> Array:
    """Return the distance of each ray's first crossing of half the step from air, NaN without one.

    `rising`: from air into the ring; otherwise from the ring into air.
    """
    samples = volume.sample(starts[:, None] + distances[None, :, None] * along[:, None], AIR_HU)
    inside = samples if rising else -samples
    level = BODY_HU if rising else -BODY_HU
    crosses = (inside[:, :-1] < level) & (inside[:, 1:] >= level)
    first = crosses.argmax(axis=1)
    rows = np.arange(len(starts))
    before, after = inside[rows, first], inside[rows, first + 1]
    share = (level - before) / np.where(after == before, 1.0, after - before)
    edges = distances[first] + share * (distances[first + 1] - distances[first])
    return np.where(crosses.any(axis=1), edges, np.nan)
