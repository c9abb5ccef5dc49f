"""The sphere's centre in the tool frame from its outlines in both images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.camera import Camera
from procedures.relocalization.errors import BadMeasurement, RaysDoNotMeet, WrongCamera, WrongSize
from procedures.relocalization.sphere_image import SphereImage
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame
from ronna_hw.text import beyond

Array = NDArray[np.float64]

SPHERE_DIAMETER_MM = 11.5  # the thesis' retro-reflective spheres
RAY_GAP_LIMIT_MM = 0.3  # a mount twisted by 0.07 degrees, or two different objects
SIZE_TOLERANCE = 0.04  # of the radius: more than film and lens cause, less than a wrong match does
LIKENESS_TOLERANCE = 0.015  # between the radii in both images, for the same sphere
ITERATIONS = 5
STEP_END_MM = 1e-9


@dataclass(frozen=True)
class StereoPoint:
    """Centre of a sphere in the tool frame, mm, with covariance (3, 3) and two consistency checks.

    `ray_gap_mm` is the gap between the two lines of sight; `radii_mm` are the radii implied by the left and
    the right outline at that distance.
    """

    position_mm: Array
    covariance_mm2: Array
    ray_gap_mm: float
    radii_mm: tuple[float, float]

    @property
    def radius_mm(self) -> float:
        """Radius of the sphere, from both outlines."""
        return sum(self.radii_mm) / 2.0


def triangulate(
    left: SphereImage,
    right: SphereImage,
    calibration: StereoHeadCalibration,
    *,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
    ray_gap_limit_mm: float = RAY_GAP_LIMIT_MM,
) -> StereoPoint:
    """Centre of the sphere in the tool frame; both outlines in full-sensor pixels.

    Removes distortion and perspective bias, then finds the point with the least weighted distance to both
    pixels. Raises STE-005 when the gap between the lines of sight exceeds the limit, STE-006 when the
    outlines do not fit a sphere of this diameter, STE-004 for numbers that are not finite.
    """
    cameras = (
        Camera(calibration.left, Frame.CAMERA_LEFT),
        Camera(calibration.right, Frame.CAMERA_RIGHT),
    )
    outlines = (left, right)
    _check(outlines)
    centres = [camera.centre_of(outline) for camera, outline in zip(cameras, outlines, strict=True)]
    start, gap = _nearest_point(cameras, centres)
    if gap > ray_gap_limit_mm:
        raise RaysDoNotMeet(
            "the lines of sight do not meet",
            limit=f"{ray_gap_limit_mm} mm",
            got=f"{beyond(gap, ray_gap_limit_mm, 3)} mm",
        )
    pixels = [camera.pixel_of(centre) for camera, centre in zip(cameras, centres, strict=True)]
    position, covariance = _weighted_point(cameras, outlines, pixels, start)
    radii = [
        math.sin(camera.angular_radius_rad(outline)) * float(np.linalg.norm(position - camera.centre_mm))
        for camera, outline in zip(cameras, outlines, strict=True)
    ]
    expected = 0.5 * sphere_diameter_mm
    for radius in radii:
        if abs(radius - expected) > SIZE_TOLERANCE * expected:
            raise WrongSize(
                "this is not a sphere of the expected size",
                expected=f"radius {expected:.2f} mm",
                limit=f"{SIZE_TOLERANCE:.0%}",
                got=f"{radius:.2f} mm",
            )
    if abs(radii[0] - radii[1]) > LIKENESS_TOLERANCE * expected:
        raise WrongSize(
            "the two images do not show the same sphere",
            expected="equal radii",
            limit=f"{LIKENESS_TOLERANCE:.1%}",
            got=f"{radii[0]:.2f} and {radii[1]:.2f} mm",
        )
    return StereoPoint(position, covariance, gap, (radii[0], radii[1]))


def check_serial(calibration: CameraCalibration, serial: str) -> None:
    """Raise STE-010 unless the calibration is for the camera with this serial number."""
    if calibration.serial != serial:
        raise WrongCamera(
            "the calibration belongs to a different camera", expected=calibration.serial, got=serial
        )


def _check(outlines: tuple[SphereImage, SphereImage]) -> None:
    for outline in outlines:
        numbers = np.array([*outline.centre_px, *outline.axes_px, *np.ravel(outline.covariance_px2)])
        if not np.all(np.isfinite(numbers)) or min(outline.axes_px) <= 0:
            raise BadMeasurement("an outline has invalid numbers", got=str(numbers))


def _nearest_point(cameras: tuple[Camera, Camera], centres: list[Array]) -> tuple[Array, float]:
    """Midpoint of the shortest segment between the lines of sight, and its length."""
    (first, second), (a, b) = cameras, [c.direction(p) for c, p in zip(cameras, centres, strict=True)]
    between = second.centre_mm - first.centre_mm
    across = np.cross(a, b)
    square = float(across @ across)
    if square < 1e-9:
        raise RaysDoNotMeet("the lines of sight are parallel")
    along_a = float(np.cross(between, b) @ across) / square
    along_b = float(np.cross(between, a) @ across) / square
    near_a, near_b = first.centre_mm + along_a * a, second.centre_mm + along_b * b
    return 0.5 * (near_a + near_b), float(np.linalg.norm(near_b - near_a))


def _weighted_point(
    cameras: tuple[Camera, Camera],
    outlines: tuple[SphereImage, SphereImage],
    pixels: list[Array],
    start: Array,
) -> tuple[Array, Array]:
    """Least squares over both images, each weighted by its covariance; Gauss-Newton from `start`."""
    weights = [np.linalg.inv(np.array(outline.covariance_px2)) for outline in outlines]
    point = start
    normal = np.eye(3)
    for _ in range(ITERATIONS):
        normal, gradient = np.zeros((3, 3)), np.zeros(3)
        for camera, weight, pixel in zip(cameras, weights, pixels, strict=True):
            projected, slope = camera.project(point)
            normal += slope.T @ weight @ slope
            gradient += slope.T @ weight @ (pixel - projected)
        step = np.linalg.solve(normal, gradient)
        point = point + step
        if float(np.abs(step).max()) < STEP_END_MM:
            break
    return point, np.asarray(np.linalg.inv(normal), dtype=float)
