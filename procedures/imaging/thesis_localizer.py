"""Localizer of the thesis, for comparison on the same data. Not for patients.

Šuligoj, Spatial patient registration in robotic neurosurgery, Zagreb 2018, section 5.1. The thesis names the
steps but no parameters: every constant here is our estimate. Steps 1 to 3: HU filter, regions, circles in the
axial and sagittal stacks; 4 and 5: clusters of circles in neighbouring planes; 6: a centre by RANSAC, from
one line through the circle centres of each stack (LineFit, the point nearest to both) or from a sphere
through points of all circles (SphereFit). It does not estimate its own error: its covariance is the FLE that
the thesis reports, equal on all axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from procedures.imaging.errors import LOCALIZATION_MISUSED
from procedures.imaging.localization import DIAMETER_MM, check_request, require_count, superior_first_key
from procedures.imaging.localizers import REPORTED_FLE_MM, ThesisFit
from procedures.imaging.markers import Candidate, Localization, Marker
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array, Mask

Box = tuple[slice, slice, slice]  # voxels (slices, rows, columns)

BODY_HU = -500  # anything above is not air
POLYMER_HU = (-500.0, 400.0)  # the filter's window
REGION_STEP_MM = 1.0  # regions are found on a coarse grid
HEAD_OPENING_MM = 21.0  # anything thinner in a slice is not the head
HEAD_MARGIN_MM = 1.0
REGION_MARGIN_MM = 8.0  # around a region, so that whole circles are visible
REGION_VOLUME_MM3 = 100.0  # at least; a sphere has 800
REGION_EXTENT_MM = 150.0  # at most: the frame has 115, a headrest and a cable are longer

PIXEL_MM = 0.25
RADIUS_MM = (2.0, 6.2)
CIRCLE_DISTANCE_MM = 5.0
SMOOTHING_PX = 1.0
EDGE_THRESHOLD, VOTES = 100.0, 14.0

AXIAL, SAGITTAL = 0, 2  # the axis perpendicular to a stack's planes: slices, columns

IN_PLANE_MM = 1.0  # centres of one sphere's circles are stacked
GAP_MM = 2.1  # a plane or two without a circle ...
GAP_PLANES = 2.1  # ... and one, where the planes are farther apart than 1 mm
HEIGHT_SHARE = (0.35, 1.10)  # of the diameter: planes in which a sphere shows circles
MIN_CIRCLES = 4
SPHERE_TOLERANCE_MM = 0.6  # between a circle's radius and the sphere's section at that height
MEETING_MM = 2.0  # between the centres of one sphere's axial and sagittal clusters

TRIALS = 200
LINE_TOLERANCE_MM = 0.5
ON_SPHERE_MM = 0.3
POINTS_PER_CIRCLE = 24
SEED = 0

RADIUS_TOLERANCE_MM = 1.0
COVARIANCE_ASSUMED = "covariance_assumed"


def localize_as_thesis(
    volume: Volume,
    fit: ThesisFit,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Localization:
    """Localize spheres with the thesis pipeline; arguments and errors as for `localize`."""
    check_request(volume, diameter_mm, expected)
    if fit not in list(ThesisFit):
        raise LOCALIZATION_MISUSED(
            "the thesis has no such fit",
            expected=" or ".join(ThesisFit),
            got=repr(fit),
            action="Give ThesisFit.LINE or ThesisFit.SPHERE.",
        )
    radius_mm = 0.5 * diameter_mm
    spacing_mm = volume.geometry.spacing_mm
    candidates: list[Candidate] = []
    markers: list[Marker] = []
    accepted_mm: list[Array] = []
    boxes = find_regions(volume)
    for number, box in enumerate(boxes):
        axial, sagittal = (
            cluster_circles(find_circles(volume, box, axis), radius_mm, float(spacing_mm[axis]))
            for axis in (AXIAL, SAGITTAL)
        )
        for pair in pair_clusters(axial, sagittal):
            centre_mm, marker, reason = _build_marker(volume, pair, fit, radius_mm)
            overlaps = any(np.linalg.norm(centre_mm - one) < diameter_mm for one in accepted_mm)
            if marker is not None and overlaps:
                marker, reason = None, "overlaps a marker that was already found"
            candidates.append(Candidate(volume.patient_mm(centre_mm), marker is not None, reason, 0.0))
            if marker is not None:
                markers.append(marker)
                accepted_mm.append(centre_mm)
        progress((number + 1) / len(boxes))
    require_count(len(markers), expected, tuple(candidates), diameter_mm)
    return Localization(
        markers=tuple(sorted(markers, key=lambda marker: superior_first_key(marker.centre_mm))),
        candidates=tuple(candidates),
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
    )


def _build_marker(
    volume: Volume, pair: tuple[Cluster, Cluster], fit: ThesisFit, radius_mm: float
) -> tuple[Array, Marker | None, str]:
    by_lines_mm = fit_lines(*pair)
    by_sphere_mm, found_radius_mm, share = fit_sphere(*pair)
    centre_mm = by_lines_mm if fit is ThesisFit.LINE else by_sphere_mm
    if abs(found_radius_mm - radius_mm) > RADIUS_TOLERANCE_MM:
        return centre_mm, None, f"has radius {found_radius_mm:.2f} mm instead of {radius_mm:.2f}"
    marker = Marker(
        centre_mm=volume.patient_mm(centre_mm),
        covariance_mm2=(REPORTED_FLE_MM[fit] ** 2 / 3.0 * np.eye(3)).tolist(),
        radius_mm=found_radius_mm,
        quality=share,
        agreement_mm=float(np.linalg.norm(by_lines_mm - by_sphere_mm)),
        flags=(COVARIANCE_ASSUMED,),
        odds=1.0,
    )
    return centre_mm, marker, "is a marker"


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles found along one axis: centres (n, 3) in grid mm (slice, row, column), radii (n,) in mm."""

    centres_mm: Array
    radii_mm: Array
    axis: int


def find_regions(volume: Volume) -> list[Box]:
    """Find the bounding box of every object that is neither air nor head."""
    spacing_mm = volume.geometry.spacing_mm
    skip = np.maximum(np.rint(REGION_STEP_MM / spacing_mm).astype(int), 1)
    body = volume.voxels[:: skip[0], :: skip[1], :: skip[2]] > BODY_HU
    step_mm = skip * spacing_mm
    opening = _disk(HEAD_OPENING_MM / step_mm[1:])
    margin = _disk(2.0 * HEAD_MARGIN_MM / step_mm[1:] + 1.0)
    rest = np.empty(body.shape, dtype=bool)
    for number, plane in enumerate(body.astype(np.uint8)):
        head = cv2.dilate(cv2.morphologyEx(plane, cv2.MORPH_OPEN, opening), margin)
        rest[number] = (plane > 0) & (head == 0)
    labels, _ = ndimage.label(rest, structure=np.ones((3, 3, 3)))
    sizes = np.bincount(labels.ravel()) * float(step_mm.prod())
    around = np.ceil(REGION_MARGIN_MM / spacing_mm).astype(int)
    boxes = []
    for number, parts in enumerate(ndimage.find_objects(labels), start=1):
        extent_mm = [(part.stop - part.start) * step for part, step in zip(parts, step_mm, strict=True)]
        if sizes[number] < REGION_VOLUME_MM3 or max(extent_mm) > REGION_EXTENT_MM:
            continue
        z, y, x = (
            slice(max(int(part.start * step - room), 0), min(int(part.stop * step + room), size))
            for part, step, room, size in zip(parts, skip, around, volume.voxels.shape, strict=True)
        )
        boxes.append((z, y, x))
    return boxes


def find_circles(volume: Volume, box: Box, axis: int) -> Circles:
    """Find the circles in every plane of a box perpendicular to `axis`."""
    spacing_mm = volume.geometry.spacing_mm
    start = np.array([part.start for part in box])
    planes = np.moveaxis(volume.voxels[box], axis, 0)
    across = [other for other in range(3) if other != axis]
    centres, radii = [], []
    for number, plane in enumerate(planes):
        found, scale = _find_plane_circles(plane, spacing_mm[across])
        for column_px, row_px, radius_px in found:
            index = np.empty(3)
            index[axis] = number
            # pixel centres of the finer image relative to voxel centres
            index[across] = (np.array([row_px, column_px]) + 0.5) * scale / spacing_mm[across] - 0.5
            centres.append((index + start) * spacing_mm)
            radii.append(radius_px * PIXEL_MM)
    return Circles(np.array(centres).reshape(-1, 3), np.array(radii), axis)


def _find_plane_circles(plane: NDArray[np.int16], spacing_mm: Array) -> tuple[Array, Array]:
    """Find the circles (column, row, radius) in a plane, in fine pixels; also return the pixel size in mm."""
    low, high = POLYMER_HU
    grey = np.clip((plane.astype(np.float32) - low) * (255.0 / (high - low)), 0.0, 255.0).astype(np.uint8)
    size = np.maximum(np.rint(np.array(plane.shape) * spacing_mm / PIXEL_MM).astype(int), 1)
    fine = cv2.resize(grey, (int(size[1]), int(size[0])), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(fine, (0, 0), SMOOTHING_PX)
    found = cv2.HoughCircles(
        fine,
        cv2.HOUGH_GRADIENT,
        dp=1.0,
        minDist=CIRCLE_DISTANCE_MM / PIXEL_MM,
        param1=EDGE_THRESHOLD,
        param2=VOTES,
        minRadius=round(RADIUS_MM[0] / PIXEL_MM),
        maxRadius=round(RADIUS_MM[1] / PIXEL_MM),
    )
    scale = np.array(plane.shape) * spacing_mm / size
    circles = np.empty((0, 3)) if found is None else np.asarray(found, dtype=float).reshape(-1, 3)
    return circles, scale


def _disk(diameters: Array) -> NDArray[np.uint8]:
    height, width = (max(round(value) | 1, 1) for value in diameters.tolist())
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, height)), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class Cluster(Circles):
    """Circles stacked along one axis, and the sphere centre they imply."""

    middle_mm: Array


def cluster_circles(circles: Circles, radius_mm: float, plane_mm: float) -> list[Cluster]:
    """Cluster circles whose radii grow and shrink like those of a sphere of `radius_mm`.

    `plane_mm` is the distance between neighbouring planes.
    """
    gap_mm = max(GAP_MM, GAP_PLANES * plane_mm)
    order = np.argsort(circles.centres_mm[:, circles.axis], kind="stable")
    across = [other for other in range(3) if other != circles.axis]
    open_chains: list[list[int]] = []
    for index in order.tolist():
        centre = circles.centres_mm[index]
        for chain in open_chains:
            centres = circles.centres_mm[chain]
            step_mm = centre[circles.axis] - centres[-1, circles.axis]
            # Compared with the median: one misplaced circle must not split those above from those below it.
            offset_mm = float(np.linalg.norm(centre[across] - np.median(centres[:, across], axis=0)))
            if 0.0 < step_mm <= gap_mm and offset_mm <= IN_PLANE_MM:
                chain.append(index)
                break
        else:
            open_chains.append([index])
    clusters = (_as_cluster(circles, chain, radius_mm) for chain in open_chains if len(chain) >= MIN_CIRCLES)
    return [cluster for cluster in clusters if cluster is not None]


def pair_clusters(axial: list[Cluster], sagittal: list[Cluster]) -> list[tuple[Cluster, Cluster]]:
    """Pair the axial and sagittal clusters of each sphere, nearest first, using each cluster once."""
    pairs = sorted(
        (float(np.linalg.norm(one.middle_mm - other.middle_mm)), i, j)
        for i, one in enumerate(axial)
        for j, other in enumerate(sagittal)
    )
    used: set[tuple[int, int]] = set()
    found = []
    for distance_mm, i, j in pairs:
        if distance_mm > MEETING_MM or (0, i) in used or (1, j) in used:
            continue
        used |= {(0, i), (1, j)}
        found.append((axial[i], sagittal[j]))
    return found


def _as_cluster(circles: Circles, chain: list[int], radius_mm: float) -> Cluster | None:
    centres_mm, radii_mm = circles.centres_mm[chain], circles.radii_mm[chain]
    height_mm = centres_mm[:, circles.axis]
    # the height of the centre that makes the circles fit a sphere best: r² = R² - (h - h0)²
    halves = np.sqrt(np.maximum(radius_mm**2 - radii_mm**2, 0.0))
    candidates = np.concatenate([height_mm - halves, height_mm + halves])
    cuts = np.sqrt(np.maximum(radius_mm**2 - (height_mm[None, :] - candidates[:, None]) ** 2, 0.0))
    fits = np.abs(cuts - radii_mm[None, :]) < SPHERE_TOLERANCE_MM
    near = np.abs(candidates - np.median(height_mm)) < radius_mm
    best = int(np.argmax(np.where(near, fits.sum(axis=1), -1)))
    keep = fits[best]
    if keep.sum() < MIN_CIRCLES:
        return None
    extent_mm = float(np.ptp(height_mm[keep]))
    if not HEIGHT_SHARE[0] < extent_mm / (2.0 * radius_mm) < HEIGHT_SHARE[1]:
        return None
    middle_mm = np.median(centres_mm[keep], axis=0)
    middle_mm[circles.axis] = float(np.mean(candidates[(fits == keep).all(axis=1)]))
    return Cluster(centres_mm[keep], radii_mm[keep], circles.axis, middle_mm)


def fit_lines(axial: Cluster, sagittal: Cluster) -> Array:
    """Return the point (3,) in grid mm nearest to the lines through the circle centres of both clusters."""
    (p, u), (q, v) = (_fit_line(cluster.centres_mm) for cluster in (axial, sagittal))
    offset, cosine = q - p, float(u @ v)
    # the feet of the common perpendicular
    along_u = (offset @ u - cosine * (offset @ v)) / (1.0 - cosine**2)
    along_v = (cosine * (offset @ u) - offset @ v) / (1.0 - cosine**2)
    return np.asarray(0.5 * (p + along_u * u + q + along_v * v))


def fit_sphere(axial: Cluster, sagittal: Cluster) -> tuple[Array, float, float]:
    """Fit a sphere to the circles: centre (3,) in grid mm, radius in mm, share of circle points on it."""
    points = np.concatenate([_circle_points(cluster) for cluster in (axial, sagittal)])

    def mark_on_sphere(sample: Array) -> Mask:
        centre, radius = _fit_algebraic_sphere(sample)
        return np.asarray(np.abs(np.linalg.norm(points - centre, axis=1) - radius) < ON_SPHERE_MM)

    best = _find_consensus(points, 4, mark_on_sphere)
    if best.sum() < 4:
        best[:] = True
    centre, radius = _fit_algebraic_sphere(points[best])
    return centre, radius, float(best.mean())


def _fit_line(points: Array) -> tuple[Array, Array]:
    """Fit a line; return a point on it and its unit direction."""

    def mark_on_line(sample: Array) -> Mask:
        direction = sample[1] - sample[0]
        direction = direction / np.linalg.norm(direction)
        offsets = points - sample[0]
        distances = np.linalg.norm(offsets - np.outer(offsets @ direction, direction), axis=1)
        return np.asarray(distances < LINE_TOLERANCE_MM)

    best = _find_consensus(points, 2, mark_on_line)
    middle = points[best].mean(axis=0)
    _, _, axes = np.linalg.svd(points[best] - middle)
    return middle, axes[0]


def _find_consensus(points: Array, count: int, mark_agreeing: Callable[[Array], Mask]) -> Mask:
    """Find the largest set of points (n,) consistent with a random sample of `count` points (RANSAC)."""
    random = np.random.default_rng(SEED)
    best = np.zeros(len(points), dtype=bool)
    for _ in range(TRIALS):
        inliers = mark_agreeing(points[random.choice(len(points), count, replace=False)])
        if inliers.sum() > best.sum():
            best = inliers
    return best


def _circle_points(cluster: Cluster) -> Array:
    angle = 2.0 * np.pi * np.arange(POINTS_PER_CIRCLE) / POINTS_PER_CIRCLE
    first, second = (other for other in range(3) if other != cluster.axis)
    ring = np.zeros((POINTS_PER_CIRCLE, 3))
    ring[:, first], ring[:, second] = np.cos(angle), np.sin(angle)
    points = cluster.centres_mm[:, None, :] + cluster.radii_mm[:, None, None] * ring[None]
    return np.asarray(points.reshape(-1, 3))


def _fit_algebraic_sphere(points: Array) -> tuple[Array, float]:
    """Solve |x|² = 2 c·x + (R² - |c|²) by least squares, with coordinates relative to the points' mean."""
    middle = points.mean(axis=0)
    offsets = points - middle
    design = np.column_stack([2.0 * offsets, np.ones(len(points))])
    solved, *_ = np.linalg.lstsq(design, (offsets**2).sum(axis=1), rcond=None)
    centre = solved[:3]
    return centre + middle, float(np.sqrt(max(solved[3] + centre @ centre, 0.0)))
