"""Locates one sphere in both images of a pair; candidates must agree between the images.

Glare or a second sphere can look like the sphere in one image. The lines of sight to two different objects do
not meet, or meet at a distance that makes the size wrong; then the other round shapes are tried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from procedures.relocalization.camera import Camera
from procedures.relocalization.errors import RaysDoNotMeet, Saturated, WrongSize
from procedures.relocalization.opencv_edges import GreyImage
from procedures.relocalization.sphere_image import SphereImage, SphereStatus
from procedures.relocalization.sphere_measurement import measure_sphere, measure_spheres
from procedures.relocalization.triangulation import SPHERE_DIAMETER_MM, StereoPoint, triangulate
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.errors import DataError

SIDES = ("left", "right")
RADIUS_TOLERANCE = 0.25  # of the radius in the image at the tool centre point: far beyond the depth of field


@dataclass(frozen=True)
class AreaImage:
    """An image and the position of its top-left pixel on the sensor."""

    pixels: GreyImage
    offset_x_px: int = 0
    offset_y_px: int = 0


@dataclass(frozen=True)
class Sighting:
    """The outlines in both images, in full-sensor pixels; the point if both are reliable."""

    left: SphereImage
    right: SphereImage
    point: StereoPoint | None

    @property
    def doubt(self) -> str:
        """Why there is no point, per camera; empty if there is one."""
        sides = zip(SIDES, (self.left, self.right), strict=True)
        return "; ".join(f"{side} camera: {one.doubt}" for side, one in sides if one.doubt)


def locate_sphere(
    left: AreaImage,
    right: AreaImage,
    calibration: StereoHeadCalibration,
    *,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
) -> Sighting:
    """The sphere as seen by both cameras; without a point if one of them sees too little of it.

    Raises the errors of `measure_sphere` with the camera's name, and STE-005 or STE-006 when no
    two round shapes match.
    """
    images = (left, right)
    ranges = tuple(
        radius_range_px(camera, sphere_diameter_mm) for camera in (calibration.left, calibration.right)
    )
    first = _outlines(images, ranges)
    if SphereStatus.UNRELIABLE in (first[0].status, first[1].status):
        return Sighting(first[0], first[1], None)
    try:
        point = triangulate(first[0], first[1], calibration, sphere_diameter_mm=sphere_diameter_mm)
    except (RaysDoNotMeet, WrongSize):
        sighting = _agreeing(images, ranges, calibration, sphere_diameter_mm)
        if sighting is None:
            raise
        return sighting
    return Sighting(first[0], first[1], point)


def radius_range_px(camera: CameraCalibration, sphere_diameter_mm: float) -> tuple[float, float]:
    """Smallest and largest radius, px, that a sphere near the tool centre point can have in the image."""
    distance_mm = float(np.linalg.norm(Camera(camera).translation_mm))
    radius = math.sqrt(math.prod(camera.focal_px)) * sphere_diameter_mm / 2.0 / distance_mm
    return (1.0 - RADIUS_TOLERANCE) * radius, (1.0 + RADIUS_TOLERANCE) * radius


def _outlines(
    images: tuple[AreaImage, AreaImage], ranges: tuple[tuple[float, float], ...]
) -> list[SphereImage]:
    """The best outline in each image, full-sensor pixels."""
    found: list[SphereImage] = []
    problems: dict[str, DataError] = {}
    for side, image, limits in zip(SIDES, images, ranges, strict=True):
        try:
            outline = measure_sphere(image.pixels, radius_range_px=limits)
        except DataError as problem:
            problems[f"{side} camera"] = problem
        else:
            found.append(outline.shifted(image.offset_x_px, image.offset_y_px))
    if problems:
        raise _named(problems)
    return found


def _named(problems: dict[str, DataError]) -> DataError:
    """One error for one or both cameras; saturation takes precedence."""
    worst = min(problems.values(), key=lambda one: not isinstance(one, Saturated))
    words = {one.what for one in problems.values()}
    if len(problems) == len(SIDES) and len(words) == 1:
        problems = {"both cameras": worst}
    what = "; ".join(f"{camera}: {one.what}" for camera, one in problems.items())
    return type(worst)(what, expected=worst.expected, limit=worst.limit, got=worst.got)


def _agreeing(
    images: tuple[AreaImage, AreaImage],
    ranges: tuple[tuple[float, float], ...],
    calibration: StereoHeadCalibration,
    sphere_diameter_mm: float,
) -> Sighting | None:
    """The pair of reliable outlines with the smallest gap between lines of sight; None if there is none."""
    found: list[list[SphereImage]] = []
    for image, limits in zip(images, ranges, strict=True):
        shapes = measure_spheres(image.pixels, radius_range_px=limits)
        reliable = [shape for shape in shapes if shape.status is SphereStatus.OK]
        found.append([shape.shifted(image.offset_x_px, image.offset_y_px) for shape in reliable])
    sightings: list[tuple[float, Sighting]] = []
    for left, right in product(*found):
        try:
            point = triangulate(left, right, calibration, sphere_diameter_mm=sphere_diameter_mm)
        except (RaysDoNotMeet, WrongSize):
            continue
        sightings.append((point.ray_gap_mm, Sighting(left, right, point)))
    return min(sightings, key=lambda each: each[0], default=(0.0, None))[1]
