"""One calibrated camera: from a sphere's outline to a line of sight, and from a point to a pixel.

Pixels are those of the full sensor, with (0, 0) at the centre of the top-left one. Distortion follows
OpenCV's five-coefficient model, k1 k2 p1 p2 k3, in normalised coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.relocalization.errors import BadMeasurement
from procedures.relocalization.sphere_image import SphereImage
from ronna_hw.calibration import CameraCalibration
from ronna_hw.frames import Frame

Array = NDArray[np.float64]

UNDISTORT_ITERATIONS = 20
UNDISTORT_END = 1e-14  # normalised units, 1e-10 px


class Camera:
    """A camera calibration prepared for computation; `tool` coordinates in mm."""

    def __init__(self, calibration: CameraCalibration, frame: Frame = Frame.CAMERA_LEFT) -> None:
        self._focal = np.array(calibration.focal_px)
        self._principal = np.array(calibration.principal_point_px)
        self._distortion = calibration.distortion
        pose = calibration.camera_from_tool.transform(frame, Frame.TOOL)
        self.rotation = pose.rotation_matrix  # camera <- tool
        self.translation_mm = pose.translation_mm
        self.centre_mm = pose.inverse().translation_mm  # centre of projection, in tool coordinates

    def project(self, point_mm: ArrayLike) -> tuple[Array, Array]:
        """Pixel (2,) of a point (3,) in tool coordinates, and its derivative (2, 3) by the point.

        The derivative neglects distortion: it only weights a least-squares step.
        """
        x, y, z = self.rotation @ np.asarray(point_mm, dtype=float) + self.translation_mm
        pixel = self._focal * distorted(np.array([x / z, y / z]), self._distortion) + self._principal
        slope = np.array([[1.0 / z, 0.0, -x / z**2], [0.0, 1.0 / z, -y / z**2]])
        return pixel, (self._focal[:, None] * slope) @ self.rotation

    def centre_of(self, sphere: SphereImage) -> Array:
        """Normalised image coordinates (2,) of the sphere's true centre, distortion and bias removed.

        The outline of a sphere is an ellipse whose centre is too far from the optical axis. With semi-minor
        axis b in normalised units, the sphere's centre is the ellipse's centre divided by (1 + b^2): the
        section of a circular cone by the image plane, solved for the cone's axis.
        """
        ellipse = self.undistorted(sphere.centre_px)
        semi_minor = sphere.axes_px[1] / float(np.sqrt(self._focal.prod()))
        return np.asarray(ellipse / (1.0 + semi_minor**2), dtype=float)

    def pixel_of(self, normalised: Array) -> Array:
        """Pixel (2,) of undistorted normalised coordinates."""
        return np.asarray(self._focal * distorted(normalised, self._distortion) + self._principal)

    def angular_radius_rad(self, sphere: SphereImage) -> float:
        """Half the angle that the sphere subtends at the centre of projection.

        From the same conic section: sin^2 a = b^2 (1 + b^2) / (r^2 + (1 + b^2)^2), r the distance of the
        ellipse's centre from the optical axis.
        """
        radius_squared = float((self.undistorted(sphere.centre_px) ** 2).sum())
        b_squared = sphere.axes_px[1] ** 2 / float(self._focal.prod())
        sine_squared = b_squared * (1.0 + b_squared) / (radius_squared + (1.0 + b_squared) ** 2)
        return float(np.arcsin(np.sqrt(sine_squared)))

    def undistorted(self, pixel: ArrayLike) -> Array:
        """Normalised coordinates (2,) without distortion, by fixed-point iteration; raises STE-004."""
        observed: Array = (np.asarray(pixel, dtype=float) - self._principal) / self._focal
        if observed.shape != (2,) or not np.all(np.isfinite(observed)):
            raise BadMeasurement("a pixel is two finite numbers", got=str(pixel))
        ideal: Array = observed.copy()
        for _ in range(UNDISTORT_ITERATIONS):
            step = observed - distorted(ideal, self._distortion)
            ideal = ideal + step
            if np.abs(step).max() < UNDISTORT_END:
                return ideal
        raise BadMeasurement("the distortion cannot be removed here", got=str(tuple(observed)))

    def direction(self, normalised: Array) -> Array:
        """Unit direction (3,) of the line of sight, in tool coordinates."""
        ray = self.rotation.T @ np.array([normalised[0], normalised[1], 1.0])
        return np.asarray(ray / np.linalg.norm(ray))


def distorted(ideal: Array, coefficients: tuple[float, float, float, float, float]) -> Array:
    """Normalised coordinates (..., 2) with lens distortion applied, k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = ideal[..., 0], ideal[..., 1]
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    return np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )
