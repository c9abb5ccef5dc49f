"""Measurement of a retro-reflective sphere in an image or image pair: centre, semi-axes, quality.

The image is reduced, circles are guessed from edges, then refined and judged on the full image, best first.
Glare or a second sphere can look like the sphere in one image. The lines of sight to two different objects do
not meet, or meet at a distance that makes the size wrong; then the other round shapes are tried.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NoReturn

import numpy as np

from procedures.relocalization.circle_search import (
    Circle,
    equalize_contrast,
    find_circles,
    find_edges,
)
from procedures.relocalization.errors import (
    BAD_MEASUREMENT,
    NoContrast,
    NoSphere,
    RaysDoNotMeet,
    Saturated,
    WrongSize,
)
from procedures.relocalization.grey_image import (
    AreaImage,
    GreyImage,
    halve_image,
    highest_grey,
    validate_image,
)
from procedures.relocalization.outline import SphereImage, SphereStatus, fit_outline
from procedures.relocalization.triangulation import (
    SPHERE_DIAMETER_MM,
    StereoPoint,
    camera_model,
    require_calibration,
    triangulate,
)
from ronna_hw.arguments import show
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.errors import DataError

REDUCED_PIXELS = 150_000  # at most, of the image in which circles are sought: a quarter of the sensor's sides
SMALLEST_RADIUS_PX = 8.0  # px of the reduced image: with less, the rim has too few pixels to judge
DARK_PERCENTILE = 2.0
BRIGHT_PERCENTILE = 99.8
CONTRAST_FLOOR = 0.02  # of the grey range; with less it is noise or a uniform field
SATURATED_LEVEL, DARK_LEVEL = 0.95, 0.15  # of the grey range, of an image without contrast

SIDES = ("left", "right")
RADIUS_TOLERANCE = 0.25  # of the radius in the image at the tool centre point: far beyond the depth of field


def measure_sphere(
    image: GreyImage, *, radius_range_px: tuple[float, float] | None = None, enhance_contrast: bool = False
) -> SphereImage:
    """Measure the bright sphere with the most visible rim in a 2-D uint8 or uint16 (12-bit) image.

    Any byte order is accepted. `radius_range_px` excludes discs of another size when the size is known.
    `enhance_contrast` equalizes the contrast first, as the thesis does (1.4); it moves the edges, and gains
    nothing here: for comparison.
    Raises STE-001 for any other image, STE-004 for an empty range, STE-002 without contrast, STE-011 when
    fully saturated, STE-003 when no sphere is in view. A sphere with too little visible rim is returned as
    UNRELIABLE.
    """
    best: SphereImage | None = None
    round_shapes = 0
    for sphere in _iterate_spheres(image, radius_range_px, enhance_contrast=enhance_contrast):
        round_shapes += 1
        if sphere is None:
            continue
        if sphere.status is SphereStatus.OK:
            return sphere
        if best is None or _visible_px(sphere) > _visible_px(best):
            best = sphere
    if best is None:
        sized = "" if radius_range_px is None else f" with a radius of {_format_range(radius_range_px)}"
        raise NoSphere(
            "no sphere in view",
            expected=f"a bright disc{sized}",
            got=f"{round_shapes} round shape(s), none of them a sphere",
        )
    return best


def measure_spheres(
    image: GreyImage, *, radius_range_px: tuple[float, float] | None = None
) -> tuple[SphereImage, ...]:
    """Measure every disc that may be a sphere, most visible rim first."""
    return tuple(sphere for sphere in _iterate_spheres(image, radius_range_px) if sphere is not None)


def _iterate_spheres(
    image: GreyImage, radius_range_px: tuple[float, float] | None, *, enhance_contrast: bool = False
) -> Iterator[SphereImage | None]:
    """Yield a measurement of each round shape, lazily, or None for shapes that are not discs."""
    grey = validate_image(image)
    if enhance_contrast:
        grey = equalize_contrast(grey)
    if radius_range_px is not None and np.shape(radius_range_px) != (2,):
        raise BAD_MEASUREMENT(
            "the range of radii is no pair",
            expected="smallest and largest, px",
            got=show(radius_range_px),
            action="Give two radii, such as (18.0, 22.0).",
        )
    if radius_range_px is not None and not 0.0 < radius_range_px[0] <= radius_range_px[1]:
        raise BAD_MEASUREMENT(
            "the range of radii is empty",
            expected="0 < smallest <= largest, px",
            got=_format_range(radius_range_px),
            action="Give the smallest radius first.",
        )
    halvings = max(0, math.ceil(0.5 * math.log2(grey.size / REDUCED_PIXELS)))
    factor, reduced = 2**halvings, halve_image(grey, halvings)
    dark, bright = np.percentile(reduced[::2, ::2], (DARK_PERCENTILE, BRIGHT_PERCENTILE)).tolist()
    full_range = float(highest_grey(grey))
    if bright - dark < CONTRAST_FLOOR * full_range:
        _refuse_uniform(dark, bright, full_range)
    low, high = radius_range_px or (SMALLEST_RADIUS_PX * factor, 0.75 * max(grey.shape))
    edges = find_edges(reduced, dark, bright)
    for guess in find_circles(edges, 0.95 * low / factor, 1.05 * high / factor):  # most visible rim first
        sphere = fit_outline(grey, _enlarge_circle(guess, factor), factor)
        in_range = sphere is not None and low <= math.sqrt(math.prod(sphere.axes_px)) <= high
        yield sphere if in_range else None


def _format_range(radius_range_px: tuple[float, float]) -> str:
    return f"{radius_range_px[0]:g} to {radius_range_px[1]:g} px"


def _refuse_uniform(dark: float, bright: float, full_range: float) -> NoReturn:
    limit, levels = f"{CONTRAST_FLOOR * full_range:.0f} grey values apart", f"{dark:.0f} to {bright:.0f}"
    if dark >= SATURATED_LEVEL * full_range:
        raise Saturated("the image is saturated", limit=limit, got=levels)
    evenness = "completely dark" if bright <= DARK_LEVEL * full_range else "uniform: it has no contrast"
    raise NoContrast(f"the image is {evenness}", limit=limit, got=levels)


def _visible_px(sphere: SphereImage) -> float:
    return sphere.rim_fraction * sphere.axes_px[0]


def _enlarge_circle(guess: Circle, factor: int) -> Circle:
    x, y = (factor * (value + 0.5) - 0.5 for value in guess.centre_px)
    return Circle((x, y), factor * guess.radius_px, guess.coverage)


@dataclass(frozen=True)
class SphereSighting:
    """Outlines in both images, in full-sensor pixels, and the point if both are reliable."""

    left: SphereImage
    right: SphereImage
    point: StereoPoint | None

    @property
    def doubt(self) -> str:
        """Reason for a missing point, by camera, or an empty string if there is a point."""
        sides = zip(SIDES, (self.left, self.right), strict=True)
        return "; ".join(f"{side} camera: {one.doubt}" for side, one in sides if one.doubt)


def locate_sphere(
    left: AreaImage,
    right: AreaImage,
    calibration: StereoHeadCalibration,
    *,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
) -> SphereSighting:
    """Locate the sphere seen by both cameras. There is no point if a camera sees too little of it.

    Raises the errors of `measure_sphere` with the camera's name, STE-005 or STE-006 when no two round shapes
    match, and ARG-001 for what is no calibration.
    """
    require_calibration(calibration)
    images = (left, right)
    cameras = calibration.left, calibration.right
    ranges = tuple(radius_range_px(camera, sphere_diameter_mm) for camera in cameras)
    shapes = _measure_outlines(images, ranges)
    if any(one.status is SphereStatus.UNRELIABLE for one in shapes):
        return SphereSighting(*shapes, None)
    try:
        return SphereSighting(
            *shapes, triangulate(*shapes, calibration, sphere_diameter_mm=sphere_diameter_mm)
        )
    except (RaysDoNotMeet, WrongSize):
        sighting = _find_agreeing(images, ranges, calibration, sphere_diameter_mm)
        if sighting is None:
            raise
        return sighting


def radius_range_px(camera: CameraCalibration, sphere_diameter_mm: float) -> tuple[float, float]:
    """Return the minimum and maximum image radius in px of a sphere near the tool centre point."""
    radius = sphere_radius_px(camera, sphere_diameter_mm)
    return (1.0 - RADIUS_TOLERANCE) * radius, (1.0 + RADIUS_TOLERANCE) * radius


def sphere_radius_px(camera: CameraCalibration, sphere_diameter_mm: float) -> float:
    """Return the image radius in px of a sphere at the tool centre point."""
    distance_mm = float(np.linalg.norm(camera_model(camera).translation_mm))
    return math.sqrt(math.prod(camera.focal_px)) * sphere_diameter_mm / 2.0 / distance_mm


def _measure_outlines(
    images: tuple[AreaImage, AreaImage], ranges: tuple[tuple[float, float], ...]
) -> tuple[SphereImage, SphereImage]:
    """Measure the best outline in each image, in full-sensor pixels."""
    found: list[SphereImage] = []
    problems: dict[str, DataError] = {}
    for side, image, limits in zip(SIDES, images, ranges, strict=True):
        try:
            outline = measure_sphere(image.pixels, radius_range_px=limits)
        except DataError as problem:
            problems[f"{side} camera"] = problem
        else:
            found.append(outline.with_offset(image.offset_x_px, image.offset_y_px))
    if problems:
        raise _combine_errors(problems)
    left, right = found
    return left, right


def _combine_errors(problems: dict[str, DataError]) -> DataError:
    """Combine the errors of one or both cameras, giving precedence to saturation."""
    worst = min(problems.values(), key=lambda one: not isinstance(one, Saturated))
    words = {one.what for one in problems.values()}
    if len(problems) == len(SIDES) and len(words) == 1:
        problems = {"both cameras": worst}
    what = "; ".join(f"{camera}: {one.what}" for camera, one in problems.items())
    return worst.reworded(what, expected=worst.expected, limit=worst.limit, got=worst.got)


def _find_agreeing(
    images: tuple[AreaImage, AreaImage],
    ranges: tuple[tuple[float, float], ...],
    calibration: StereoHeadCalibration,
    sphere_diameter_mm: float,
) -> SphereSighting | None:
    """Find the reliable outlines with the smallest ray gap, or return None if none agree."""
    found = [
        [
            shape.with_offset(image.offset_x_px, image.offset_y_px)
            for shape in measure_spheres(image.pixels, radius_range_px=limits)
            if shape.status is SphereStatus.OK
        ]
        for image, limits in zip(images, ranges, strict=True)
    ]
    sightings: list[tuple[float, SphereSighting]] = []
    for left, right in product(*found):
        try:
            point = triangulate(left, right, calibration, sphere_diameter_mm=sphere_diameter_mm)
        except (RaysDoNotMeet, WrongSize):
            continue
        sightings.append((point.ray_gap_mm, SphereSighting(left, right, point)))
    return min(sightings, key=lambda each: each[0], default=(0.0, None))[1]
