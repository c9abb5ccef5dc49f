"""A small renderer of spheres for these tests: ray against sphere, supersampled at the rim, then optics.

It shares nothing with the measurement, nor with the cameras of the theatre.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter
from scipy.spatial.transform import Rotation

from ronna_hw.calibration import CameraCalibration, PoseRecord, StereoHeadCalibration
from ronna_hw.plausible import FINEST_MM

SENSOR = (2048, 1088)
FOCAL_PX = 62.5e3 / 5.5  # principal distance 62.5 mm, pixels of 5.5 um
WORKING_DISTANCE_MM = 250.0
HALF_ANGLE_DEG = 27.5
RADIUS_MM = 5.75
SUBSAMPLES = 8
RIM_PX = 2  # to each side of the outline: where shading changes within a pixel


@dataclass(frozen=True)
class Look:
    """What else there is in the picture. Grey levels are shares of the sphere's brightness."""

    blur_px: float = 1.0
    bright: float = 180.0
    dark: float = 12.0
    limb_darkening: float = 0.25
    grain: float = 0.04
    noise: bool = True
    post: bool = False
    stains: int = 0
    occluded_width: float = 0.0
    occluder_angle_rad: float | None = None
    unevenness: float = 0.0  # change of brightness over the sphere's diameter
    bits: int = 8


class Renderer:
    """Pictures of spheres, all from one seeded generator."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)

    def sphere(
        self,
        centre_mm: NDArray[np.float64],
        look: Look | None = None,
        *,
        size: tuple[int, int] = SENSOR,
        principal_px: tuple[float, float] | None = None,
        focal_px: float = FOCAL_PX,
        radius_mm: float = RADIUS_MM,
        scene: NDArray[np.float64] | None = None,
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """The image of a sphere at `centre_mm` (camera coordinates) on an even or a given background."""
        look = look or Look()
        width, height = size
        cx, cy = principal_px or ((width - 1) / 2, (height - 1) / 2)
        radiance = np.full((height, width), look.dark) if scene is None else scene.astype(float).copy()
        u0 = focal_px * centre_mm[0] / centre_mm[2] + cx
        v0 = focal_px * centre_mm[1] / centre_mm[2] + cy
        r0 = focal_px * radius_mm / centre_mm[2]
        beside = (
            1.9 if look.post or look.occluded_width else 1.15
        )  # radii, with what is drawn beside the sphere
        reach = int(beside * r0 + 8 * look.blur_px + 4)
        left, right = max(0, int(u0) - reach), min(width, int(u0) + reach)
        top, bottom = max(0, int(v0) - reach), min(height, int(v0) + reach)
        if left >= right or top >= bottom:
            return self._exposed(radiance, look)
        u, v = np.meshgrid(np.arange(left, right, dtype=float), np.arange(top, bottom, dtype=float))

        def shade(px: NDArray[np.float64], py: NDArray[np.float64]) -> NDArray[np.float64]:
            """Share of brightness at image points; negative where the ray misses the sphere."""
            dx, dy = (px - cx) / focal_px, (py - cy) / focal_px
            square = dx * dx + dy * dy + 1.0
            along = dx * centre_mm[0] + dy * centre_mm[1] + centre_mm[2]
            inside = along**2 - square * (float(centre_mm @ centre_mm) - radius_mm**2)
            cosine = np.sqrt(np.maximum(inside, 0.0) / square) / radius_mm
            shading = 1.0 - look.limb_darkening * (1.0 - cosine)
            shading *= 1.0 + look.unevenness * (px - u0) / (2 * r0)
            return np.where(inside >= 0, shading, -1.0)

        value = shade(u, v)
        texture = 1.0 + look.grain * gaussian_filter(self.random.standard_normal(u.shape), 1.5) * 5.0
        patch = radiance[top:bottom, left:right]
        patch = np.where(value >= 0, look.bright * value * texture, patch)
        hit = value >= 0
        rows, columns = np.nonzero(
            binary_dilation(hit, iterations=RIM_PX) & ~binary_erosion(hit, iterations=RIM_PX)
        )
        steps = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
        sub_x, sub_y = (grid.ravel() for grid in np.meshgrid(steps, steps))
        fine = shade(u[rows, columns][:, None] + sub_x, v[rows, columns][:, None] + sub_y)
        ground = radiance[top:bottom, left:right][rows, columns][:, None]
        lit = look.bright * fine * texture[rows, columns][:, None]
        patch[rows, columns] = np.where(fine >= 0, lit, ground).mean(axis=1)
        patch = self._obstructed(patch, u, v, (u0, v0), r0, look)
        radiance[top:bottom, left:right] = patch
        soft = gaussian_filter(patch, look.blur_px)
        margin = int(4 * look.blur_px) + 1
        inner = (slice(margin if top else None, -margin), slice(margin if left else None, -margin))
        radiance[top:bottom, left:right][inner] = soft[inner]
        if scene is not None:
            return self._exposed(radiance, look)
        picture = _background(size, look.dark, look.noise, look.bits).copy()
        picture[top:bottom, left:right] = self._exposed(radiance[top:bottom, left:right], look)
        return picture

    def _obstructed(
        self,
        patch: NDArray[np.float64],
        u: NDArray[np.float64],
        v: NDArray[np.float64],
        centre: tuple[float, float],
        radius: float,
        look: Look,
    ) -> NDArray[np.float64]:
        x, y = (u - centre[0]) / radius, (v - centre[1]) / radius
        if look.post:  # a post that cuts into the lower rim, on a wider base
            patch = np.where((np.abs(x) < 0.25) & (y > 0.93) & (y < 1.5), 0.4 * look.bright, patch)
            patch = np.where((np.abs(x) < 0.6) & (y >= 1.5) & (y < 1.75), 0.3 * look.bright, patch)
        for _ in range(look.stains):
            angle, place = self.random.uniform(0, 2 * np.pi), np.sqrt(self.random.uniform(0, 1.05))
            size = self.random.uniform(0.05, 0.13)
            spot = np.hypot(x - place * np.cos(angle), y - place * np.sin(angle)) < size
            patch = np.where(spot & (patch > 2 * look.dark), 0.35 * patch, patch)
        if look.occluded_width:
            angle = look.occluder_angle_rad
            if angle is None:
                angle = self.random.uniform(0, 2 * np.pi)
            beyond = x * np.cos(angle) + y * np.sin(angle) > 1.0 - 2.0 * look.occluded_width
            patch = np.where(beyond, 1.5 * look.dark, patch)
        return patch

    def _exposed(self, radiance: NDArray[np.float64], look: Look) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Shot and read noise of an 11.9 ke- pixel, then 8 or 12 bits."""
        electrons = radiance.astype(np.float32) * np.float32(11_900.0 / 255.0)
        if look.noise:
            spread = np.sqrt(np.maximum(electrons, 0.0) + np.float32(13.5**2))
            electrons += spread * self.random.standard_normal(radiance.shape, dtype=np.float32)
        top = 2**look.bits - 1
        grey = np.clip(np.rint(electrons * np.float32(top / 11_900.0)), 0, top)
        return grey.astype(np.uint8 if look.bits == 8 else np.uint16)


@cache
def _background(size: tuple[int, int], dark: float, noise: bool, bits: int) -> NDArray[Any]:
    """An exposed picture of nothing. Its noise is drawn once: most of a picture is far from the sphere."""
    width, height = size
    return Renderer(seed=12)._exposed(np.full((height, width), dark), Look(noise=noise, bits=bits))


class Head:
    """Two ideal cameras that look at the tool centre point, 55 degrees apart."""

    def __init__(self, principal_px: tuple[float, float] = (1023.5, 543.5)) -> None:
        self.principal_px = principal_px
        self.poses = {}
        for side, sign in (("left", -1.0), ("right", 1.0)):
            turn = Rotation.from_euler("y", sign * HALF_ANGLE_DEG, degrees=True)
            self.poses[side] = (turn, np.array([0.0, 0.0, WORKING_DISTANCE_MM]))
        now = datetime.now(UTC)
        self.calibration = StereoHeadCalibration(
            identifier="test-head",
            created=now,
            expires=now + timedelta(days=1),
            made_by="tests",
            stated_error_mm=FINEST_MM,
            flange_from_tool=PoseRecord(translation_mm=(0, 0, 0), quaternion_wxyz=(1, 0, 0, 0)),
            left=self._camera("left"),
            right=self._camera("right"),
        )

    def in_camera(self, side: str, point_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """A point in tool coordinates in the coordinates of a camera."""
        turn, shift = self.poses[side]
        return turn.apply(point_mm) + shift

    def _camera(self, side: str) -> CameraCalibration:
        turn, shift = self.poses[side]
        return CameraCalibration(
            serial=side,
            focal_px=(FOCAL_PX, FOCAL_PX),
            principal_point_px=self.principal_px,
            camera_from_tool=PoseRecord(
                translation_mm=tuple(shift.tolist()),
                quaternion_wxyz=tuple(turn.as_quat(scalar_first=True).tolist()),
            ),
        )


@pytest.fixture
def renderer() -> Renderer:
    return Renderer(seed=11)


@pytest.fixture
def head() -> Head:
    return Head()


@pytest.fixture
def look() -> type[Look]:
    return Look
