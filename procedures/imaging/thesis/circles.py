"""The thesis' pipeline, steps 1 to 3: HU filter, regions, circles in the axial and sagittal stacks.

Šuligoj, Spatial patient registration in robotic neurosurgery, Zagreb 2018, section 5.1. The thesis names the
steps but no parameters: every constant here is our estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from procedures.imaging.volume import Volume

Array = NDArray[np.float64]
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


@dataclass(frozen=True, eq=False)
class Circles:
    """Circles of one stack: centres (n, 3) grid mm (slice, row, column), radii (n,) mm."""

    centres_mm: Array
    radii_mm: Array
    axis: int


def find_regions(volume: Volume) -> list[Box]:
    """Boxes around everything that is neither air nor head."""
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
        low = [part.start * k - a for part, k, a in zip(parts, skip, around, strict=True)]
        high = [part.stop * k + a for part, k, a in zip(parts, skip, around, strict=True)]
        z, y, x = (
            slice(max(int(a), 0), min(int(b), n))
            for a, b, n in zip(low, high, volume.voxels.shape, strict=True)
        )
        boxes.append((z, y, x))
    return boxes


def find_circles(volume: Volume, box: Box, axis: int) -> Circles:
    """Circles in every plane of a box perpendicular to `axis`."""
    spacing_mm = volume.geometry.spacing_mm
    start = np.array([part.start for part in box])
    planes = np.moveaxis(volume.voxels[box], axis, 0)
    across = [other for other in range(3) if other != axis]
    centres, radii = [], []
    for number, plane in enumerate(planes):
        found, scale = _hough(plane, spacing_mm[across])
        for column_px, row_px, radius_px in found:
            index = np.empty(3)
            index[axis] = number
            # pixel centres of the finer image relative to voxel centres
            index[across] = (np.array([row_px, column_px]) + 0.5) * scale / spacing_mm[across] - 0.5
            centres.append((index + start) * spacing_mm)
            radii.append(radius_px * PIXEL_MM)
    return Circles(np.array(centres).reshape(-1, 3), np.array(radii), axis)


def _hough(plane: NDArray[np.int16], spacing_mm: Array) -> tuple[Array, Array]:
    """Circles (column, row, radius) of a plane in fine pixels, and the exact pixel size in mm."""
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
