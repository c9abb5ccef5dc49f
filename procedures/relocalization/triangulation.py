"""Triangulation of the sphere's centre in the tool frame from two outlines, and check of the cameras.

Pixels are those of the full sensor, with (0, 0) at the centre of the top-left one. Distortion follows
OpenCV's five-coefficient model, k1 k2 p1 p2 k3, in normalised coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from procedures.relocalization.errors import (
    BAD_MEASUREMENT,
    HEAD_TURNED,
    WRONG_CAMERA,
    RaysDoNotMeet,
    WrongSize,
)
from procedures.relocalization.outline import SphereImage
from ronna_hw.arguments import WrongArgument, show
from ronna_hw.arrays import Array
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame
from ronna_hw.text import format_against_limit, format_distinct

UNDISTORT_ITERATIONS = 20
UNDISTORT_END = 1e-14  # normalised units, 1e-10 px

SPHERE_DIAMETER_MM = 11.5  # the thesis' retro-reflective spheres
RAY_GAP_LIMIT_MM = 0.3  # a mount twisted by 0.07 degrees, or two different objects
SIZE_TOLERANCE = 0.04  # of the radius: more than film and lens cause, less than a wrong match does
LIKENESS_TOLERANCE = 0.015  # between the radii in both images, for the same sphere
ITERATIONS = 5
STEP_END_MM = 1e-9

# Left minus right radius over the sphere's. Focal lengths known to 1e-4 each scatter it by 1.5e-4 from head
# to head (0.04e-2 at most over the scenes of seeds 0 to 19); 0.2 deg change it by 0.16e-2 to 0.20e-2.
LARGEST_UNLIKENESS = 0.0009
# Mean radius over the expected. The same focal lengths scatter it by 1.1e-4 (at most 2.2e-4 over 21 heads).
LARGEST_SIZE_ERROR = 0.0005
# Over the stated error of a point, to which cameras that are off by as much at random open a gap; those of a
# calibration leave 0.001 mm.
LARGEST_GAP_OVER_STATED = 5.0
LEAST_GAP_LIMIT_MM = 0.02  # rims measured to a few micrometres never meet better


class CameraModel:
    """Camera calibration in computational form, with tool coordinates in mm; see `camera_model`."""

    def __init__(self, calibration: CameraCalibration, frame: Frame = Frame.CAMERA_LEFT) -> None:
        self._focal = np.array(calibration.focal_px)
        self._principal = np.array(calibration.principal_point_px)
        self._distortion = calibration.distortion
        pose = calibration.camera_from_tool.transform(frame, Frame.TOOL)
        self.rotation = pose.rotation_matrix  # camera <- tool
        self.translation_mm = pose.translation_mm
        self.centre_mm = pose.inverse().translation_mm  # centre of projection, in tool coordinates

    def project(self, point_mm: ArrayLike) -> tuple[Array, Array]:
        """Project a point (3,) in tool coordinates to a pixel (2,), and return the Jacobian (2, 3).

        The derivative neglects distortion: it only weights a least-squares step.
        """
        x, y, z = self.rotation @ np.asarray(point_mm, dtype=float) + self.translation_mm
        slope = np.array([[1.0 / z, 0.0, -x / z**2], [0.0, 1.0 / z, -y / z**2]])
        return self.to_pixel(np.array([x / z, y / z])), (self._focal[:, None] * slope) @ self.rotation

    def centre_of(self, sphere: SphereImage) -> Array:
        """Return normalized coordinates (2,) of the sphere's true centre, corrected for distortion and bias.

        The outline of a sphere is an ellipse whose centre is too far from the optical axis. With semi-minor
        axis b in normalised units, the sphere's centre is the ellipse's centre divided by (1 + b^2): the
        section of a circular cone by the image plane, solved for the cone's axis.
        """
        ellipse = self.undistort(sphere.centre_px)
        semi_minor = sphere.axes_px[1] / float(np.sqrt(self._focal.prod()))
        return np.asarray(ellipse / (1.0 + semi_minor**2), dtype=float)

    def to_pixel(self, normalised: Array) -> Array:
        """Convert undistorted normalized coordinates to a pixel (2,)."""
        return np.asarray(self._focal * distort(normalised, self._distortion) + self._principal)

    def angular_radius_rad(self, sphere: SphereImage) -> float:
        """Return half the angle subtended by the sphere at the projection centre.

        From the same conic section: sin^2 a = b^2 (1 + b^2) / (r^2 + (1 + b^2)^2), r the distance of the
        ellipse's centre from the optical axis.
        """
        radius_squared = float((self.undistort(sphere.centre_px) ** 2).sum())
        b_squared = sphere.axes_px[1] ** 2 / float(self._focal.prod())
        sine_squared = b_squared * (1.0 + b_squared) / (radius_squared + (1.0 + b_squared) ** 2)
        return float(np.arcsin(np.sqrt(sine_squared)))

    def undistort(self, pixel: ArrayLike) -> Array:
        """Convert pixels (..., 2) to undistorted normalized coordinates iteratively. Raises STE-004."""
        observed: Array = (np.asarray(pixel, dtype=float) - self._principal) / self._focal
        if observed.shape[-1:] != (2,) or not np.all(np.isfinite(observed)):
            raise BAD_MEASUREMENT("a pixel is two finite numbers", got=str(pixel))
        ideal: Array = observed.copy()
        for _ in range(UNDISTORT_ITERATIONS):
            step = observed - distort(ideal, self._distortion)
            ideal = ideal + step
            if np.abs(step).max() < UNDISTORT_END:
                return ideal
        raise BAD_MEASUREMENT("the distortion cannot be removed here", got=str(tuple(observed)))

    def direction(self, normalised: Array) -> Array:
        """Return the unit direction (3,) of the line of sight, in tool coordinates."""
        ray = self.rotation.T @ np.array([normalised[0], normalised[1], 1.0])
        return np.asarray(ray / np.linalg.norm(ray))


@lru_cache(maxsize=8)  # two cameras of a head, each in the frames that it is asked for
def camera_model(calibration: CameraCalibration, frame: Frame = Frame.CAMERA_LEFT) -> CameraModel:
    """Return the model of a camera, built once: a look asks for it eight times."""
    return CameraModel(calibration, frame)


def distort(ideal: Array, coefficients: tuple[float, float, float, float, float]) -> Array:
    """Apply lens distortion, k1 k2 p1 p2 k3, to normalized coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = ideal[..., 0], ideal[..., 1]
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    distorted = np.empty(ideal.shape)
    distorted[..., 0] = x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x)
    distorted[..., 1] = y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y
    return distorted


@dataclass(frozen=True)
class StereoPoint:
    """Sphere centre in the tool frame, mm, with covariance (3, 3) and two consistency measures.

    `ray_gap_mm` is the gap between the two lines of sight; `radii_mm` are the radii implied by the left and
    the right outline at that distance.
    """

    position_mm: Array
    covariance_mm2: Array
    ray_gap_mm: float
    radii_mm: tuple[float, float]

    @property
    def radius_mm(self) -> float:
        """Sphere radius averaged over both outlines."""
        return sum(self.radii_mm) / 2.0


def triangulate(
    left: SphereImage,
    right: SphereImage,
    calibration: StereoHeadCalibration,
    *,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
    ray_gap_limit_mm: float = RAY_GAP_LIMIT_MM,
) -> StereoPoint:
    """Find the sphere's centre in the tool frame from both outlines in full-sensor pixels.

    Removes distortion and perspective bias, then finds the point with the least weighted distance to both
    pixels. Raises STE-005 when the gap between the lines of sight exceeds the limit, STE-006 when the
    outlines do not fit a sphere of this diameter, STE-004 for numbers that are not finite, ARG-001 for what
    is no outline or no calibration.
    """
    require_calibration(calibration)
    cameras = (
        camera_model(calibration.left, Frame.CAMERA_LEFT),
        camera_model(calibration.right, Frame.CAMERA_RIGHT),
    )
    outlines = (left, right)
    _check_outlines(outlines)
    centres = [camera.centre_of(outline) for camera, outline in zip(cameras, outlines, strict=True)]
    start, gap = _find_nearest_point(cameras, centres)
    if gap > ray_gap_limit_mm:
        raise RaysDoNotMeet(
            "the lines of sight do not meet",
            limit=f"{ray_gap_limit_mm} mm",
            got=f"{format_against_limit(gap, ray_gap_limit_mm, 3)} mm",
        )
    pixels = [camera.to_pixel(centre) for camera, centre in zip(cameras, centres, strict=True)]
    position, covariance = _minimise_distances(cameras, outlines, pixels, start)
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
        raise WRONG_CAMERA(
            "the calibration belongs to a different camera", expected=calibration.serial, got=serial
        )


def require_calibration(given: object) -> None:
    """Raise ARG-001 for anything else than the calibration of a stereo head."""
    if not isinstance(given, StereoHeadCalibration):
        words = "the calibration is none of a stereo head"
        raise WrongArgument(words, expected="a StereoHeadCalibration", got=show(given))


def _check_outlines(outlines: tuple[SphereImage, SphereImage]) -> None:
    for outline in outlines:
        if not isinstance(outline, SphereImage):
            raise WrongArgument(
                "an outline is none", expected="what measure_sphere returns", got=show(outline)
            )
        numbers = np.array([*outline.centre_px, *outline.axes_px, *np.ravel(outline.covariance_px2)])
        if not np.all(np.isfinite(numbers)) or min(outline.axes_px) <= 0:
            raise BAD_MEASUREMENT("an outline has invalid numbers", got=str(numbers))


def _find_nearest_point(
    cameras: tuple[CameraModel, CameraModel], centres: list[Array]
) -> tuple[Array, float]:
    """Return the midpoint of the shortest segment between the lines of sight, and its length in mm."""
    (first, second), (a, b) = cameras, [c.direction(p) for c, p in zip(cameras, centres, strict=True)]
    baseline = second.centre_mm - first.centre_mm
    across = np.cross(a, b)
    square = float(across @ across)
    if square < 1e-9:
        raise RaysDoNotMeet("the lines of sight are parallel")
    along_a = float(np.cross(baseline, b) @ across) / square
    along_b = float(np.cross(baseline, a) @ across) / square
    near_a, near_b = first.centre_mm + along_a * a, second.centre_mm + along_b * b
    return 0.5 * (near_a + near_b), float(np.linalg.norm(near_b - near_a))


def _minimise_distances(
    cameras: tuple[CameraModel, CameraModel],
    outlines: tuple[SphereImage, SphereImage],
    pixels: list[Array],
    start: Array,
) -> tuple[Array, Array]:
    """Minimize the weighted distance to both pixels by Gauss-Newton. Return the point and covariance."""
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


def check_head(
    radii_mm: Sequence[tuple[float, float]],
    ray_gaps_mm: Sequence[float],
    stated_error_mm: float,
    sphere_diameter_mm: float = SPHERE_DIAMETER_MM,
) -> None:
    """Raise STE-014 if the spheres of one re-localization show that a camera has moved.

    `radii_mm` are the radii from the left and the right outline at the measured position, per sphere;
    `stated_error_mm` is from the head's calibration record, `sphere_diameter_mm` as its cameras see them.

    A camera that rotates in its mount shifts every sphere by the same vector, which neither the registration
    residual nor the distances between spheres can reveal. Each image pair shows it in three ways:

    - a rotation in the plane of both lines of sight moves their intersection towards one camera and away from
      the other, so the sphere's outlines have unequal sizes: 0.17 % for 0.2 degrees.
    - both cameras rotated towards each other move it nearer, and the spheres appear too small: by 0.26 % and
      more for 0.2 degrees each, with equal outlines.
    - a rotation out of that plane opens a gap between the lines of sight: 0.9 mm for 0.2 degrees.

    All are medians over all spheres of a re-localization, so that blood or glare on one of them does not
    count.
    """
    unlikeness = median(2.0 * (left - right) / (left + right) for left, right in radii_mm)
    if abs(unlikeness) > LARGEST_UNLIKENESS:
        raise HEAD_TURNED(
            "a camera of the stereo head has rotated: the spheres appear larger in one "
            "camera than in the other",
            limit=f"{LARGEST_UNLIKENESS:.2%}",
            got=f"{abs(unlikeness):.2%}",
        )
    radius_mm = median((left + right) / 2.0 for left, right in radii_mm)
    size_error = 2.0 * radius_mm / sphere_diameter_mm - 1.0
    if abs(size_error) > LARGEST_SIZE_ERROR:
        raise HEAD_TURNED(
            "both cameras of the stereo head have rotated, or these are other spheres: their size is wrong",
            limit=f"{LARGEST_SIZE_ERROR:.2%} of {sphere_diameter_mm:g} mm (procedure.sphere_diameter_mm)",
            got=f"{abs(size_error):.2%}",
        )
    gap_mm = median(ray_gaps_mm)
    limit_mm = max(LEAST_GAP_LIMIT_MM, LARGEST_GAP_OVER_STATED * stated_error_mm)
    if gap_mm > limit_mm:
        gap, limit = format_distinct(gap_mm, limit_mm, 2)
        words = "a camera of the stereo head has moved: the lines of sight do not meet"
        raise HEAD_TURNED(words, limit=f"{limit} mm", got=f"{gap} mm")
