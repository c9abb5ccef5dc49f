"""A lens and its rays: pinhole, distortion k1 k2 p1 p2 k3, and defocus blur.

Camera frame: x right, y down, z along the optical axis. Pixels: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.wire.gige_vision import PIXEL_PITCH_UM
from sim.world.scene.model import CameraTruth

Array = NDArray[np.float64]

F_NUMBER = 8.0  # macro work: stopped down for depth of field
# Diffraction at f/8, magnification 0.25 and 850 nm (0.42 * wavelength * effective f-number), in pixels.
SHARPEST_SIGMA_PX = 0.42 * 0.85 * F_NUMBER * 1.25 / PIXEL_PITCH_UM
LARGEST_SIGMA_PX = 12.0  # a sphere farther out of focus is drawn with this blur
DISC_TO_SIGMA = 0.25  # a uniform disc of diameter D has a standard deviation of D / 4 along one axis
UNDISTORT_STEPS = 8  # each step gains about three digits with the distortion of these lenses


@dataclass(frozen=True)
class Lens:
    """Pinhole with distortion, focused at `focus_mm`."""

    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    focus_mm: float

    @classmethod
    def of(cls, camera: CameraTruth) -> Lens:
        """The lens of a camera, focused on the tool centre point."""
        return cls(
            camera.focal_px,
            camera.principal_point_px,
            camera.distortion,
            camera.camera_from_tool.translation_mm[2],
        )

    def project(self, points_mm: ArrayLike) -> Array:
        """Pixel positions (n, 2) of points (n, 3) in front of the camera."""
        points = np.asarray(points_mm, dtype=float)
        distorted = self._distort(points[:, :2] / points[:, 2:])
        return distorted * self.focal_px + self.principal_point_px

    def rays(self, pixels: ArrayLike) -> Array:
        """Directions (n, 2): x and y of the ray (x, y, 1) of each pixel position (n, 2)."""
        seen = (np.asarray(pixels, dtype=float) - self.principal_point_px) / self.focal_px
        straight = seen
        for _ in range(UNDISTORT_STEPS):
            straight = straight + (seen - self._distort(straight))
        return straight

    def blur_sigma_px(self, depth_mm: float) -> float:
        """Standard deviation of the blur of a point at this depth (thin lens, uniform disc)."""
        aperture_px = (self.focal_px[0] / (1.0 + self.magnification)) / F_NUMBER
        disc_px = aperture_px * self.magnification * abs(depth_mm - self.focus_mm) / depth_mm
        return min(float(np.hypot(SHARPEST_SIGMA_PX, DISC_TO_SIGMA * disc_px)), LARGEST_SIGMA_PX)

    @property
    def magnification(self) -> float:
        """Image size over object size in the plane of focus."""
        return self.focal_px[0] * PIXEL_PITCH_UM * 1e-3 / self.focus_mm

    def _distort(self, straight: Array) -> Array:
        k1, k2, p1, p2, k3 = self.distortion
        x, y = straight[:, 0], straight[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.column_stack(
            [
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            ]
        )
