"""The lens, the irradiance it casts on part of the sensor, and defocus blur.

Camera frame: x right, y down, z along the optical axis. Pixels: (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.wire.gige_vision import PIXEL_PITCH_UM
from sim.world.rigid import Array
from sim.world.scene.model import CameraTruth

F_NUMBER = 8.0  # macro work: stopped down for depth of field
# Diffraction at f/8, magnification 0.25 and 850 nm (0.42 * wavelength * effective f-number), in pixels.
SHARPEST_SIGMA_PX = 0.42 * 0.85 * F_NUMBER * 1.25 / PIXEL_PITCH_UM
EFFECTIVE_F_NUMBER = 1.25 * F_NUMBER  # at magnification 0.25
LARGEST_SIGMA_PX = 12.0  # a sphere farther out of focus is drawn with this blur
DISC_TO_SIGMA = 0.25  # a uniform disc of diameter D has a standard deviation of D / 4 along one axis
UNDISTORT_STEPS = 8  # each step gains about three digits with the distortion of these lenses

Image = NDArray[np.float32]

OUTLINE_MARGIN_PX = 3  # an outline is given by points, and a rim has a width
NEAREST_POINT_MM = 30.0  # the lens is longer than that
BAND_PIXELS = 1 << 16  # processed at a time: intermediate results fit into a processor's cache

KERNEL_LIMIT_PX = 2.5  # above, three box filters are as good (their sum is nearly normal) and faster
SPREAD_SIGMAS = 3.5  # light from farther away adds less than 0.05 %


@dataclass(frozen=True)
class Lens:
    """Pinhole lens with distortion k1 k2 p1 p2 k3, focused at `focus_mm`."""

    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    focus_mm: float

    @classmethod
    def from_camera(cls, camera: CameraTruth) -> Lens:
        """Return the lens of a camera, focused on the tool centre point."""
        return cls(
            camera.focal_px,
            camera.principal_point_px,
            camera.distortion,
            camera.camera_from_tool.translation_mm[2],
        )

    def project(self, points_mm: ArrayLike) -> Array:
        """Project points (n, 3) in front of the camera to pixels (n, 2)."""
        points = np.asarray(points_mm, dtype=float)
        straight = points[:, :2] / points[:, 2:]
        distorted = np.column_stack(self._distort(straight[:, 0], straight[:, 1]))
        return distorted * self.focal_px + self.principal_point_px

    def rays(self, pixels: ArrayLike) -> Array:
        """Return x and y of the ray (x, y, 1) for each pixel position (n, 2)."""
        seen = (np.asarray(pixels, dtype=float) - self.principal_point_px) / self.focal_px
        seen_x, seen_y = seen.T.copy()
        x, y = seen_x, seen_y
        for _ in range(UNDISTORT_STEPS):
            distorted_x, distorted_y = self._distort(x, y)
            x, y = x + (seen_x - distorted_x), y + (seen_y - distorted_y)
        return np.column_stack([x, y])

    def blur_sigma_px(self, depth_mm: float) -> float:
        """Return the standard deviation of the blur at a depth (thin lens, uniform disc)."""
        disc_px = self._disc_px_per_mm * abs(depth_mm - self.focus_mm) / depth_mm
        return min(float(np.hypot(SHARPEST_SIGMA_PX, DISC_TO_SIGMA * disc_px)), LARGEST_SIGMA_PX)

    def blur_sigmas_px(self, depths_mm: Array) -> Array:
        """Return the standard deviations (n,) of the blur at depths (n,)."""
        disc_px = self._disc_px_per_mm * np.abs(depths_mm - self.focus_mm) / depths_mm
        return np.asarray(np.minimum(np.hypot(SHARPEST_SIGMA_PX, DISC_TO_SIGMA * disc_px), LARGEST_SIGMA_PX))

    @property
    def _disc_px_per_mm(self) -> float:
        """Diameter of the disc of confusion, by the depth out of focus relative to the depth."""
        aperture_px = (self.focal_px[0] / (1.0 + self.magnification)) / F_NUMBER
        return aperture_px * self.magnification

    @property
    def magnification(self) -> float:
        """Ratio of image size to object size in the plane of focus."""
        return self.focal_px[0] * PIXEL_PITCH_UM * 1e-3 / self.focus_mm

    def _distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


@dataclass(frozen=True)
class Area:
    """Area of interest on the sensor, in pixels."""

    x: int
    y: int
    width: int
    height: int

    def expand(self, margin: int) -> Area:
        """Return the area expanded by a margin on all sides, possibly beyond the sensor."""
        return Area(self.x - margin, self.y - margin, self.width + 2 * margin, self.height + 2 * margin)

    def intersect(self, other: Area) -> Area:
        """Return the intersection, with zero width or height if the areas are disjoint."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Area(x, y, max(0, right - x), max(0, bottom - y))

    @property
    def empty(self) -> bool:
        """Whether the area contains no pixels."""
        return self.width == 0 or self.height == 0


def row_bands(height: int, width: int) -> Iterator[slice]:
    """Yield the rows of an image in bands.

    An operation on a whole image writes megabytes of fresh memory, which costs more than the arithmetic.
    """
    rows = max(1, BAND_PIXELS // max(1, width))
    for top in range(0, height, rows):
        yield slice(top, min(top + rows, height))


def bounds_of(lens: Lens, points_mm: NDArray[np.float64]) -> Area:
    """Return the image area spanned by points (n, 3) plus a margin, empty if all are behind the lens."""
    points = points_mm[points_mm[:, 2] > NEAREST_POINT_MM]
    if not len(points):
        return Area(0, 0, 0, 0)
    pixels = lens.project(points)
    left, top = (floor(value) - OUTLINE_MARGIN_PX for value in pixels.min(axis=0))
    right, bottom = (ceil(value) + OUTLINE_MARGIN_PX + 1 for value in pixels.max(axis=0))
    return Area(left, top, right - left, bottom - top)


@dataclass(frozen=True)
class PixelCanvas:
    """Light on `area`, in electrons per microsecond per pixel."""

    area: Area
    light: Image

    def part(self, area: Area) -> Image:
        """Return a view of the light in `area`, which must lie inside this canvas."""
        top, left = area.y - self.area.y, area.x - self.area.x
        return self.light[top : top + area.height, left : left + area.width]


@dataclass(frozen=True)
class Dot:
    """Dot products of a vector with the rays of an area, stored as a row term plus a column term."""

    rows: Image  # (height, 1)
    columns: Image  # (1, width)

    def sum_rows(self, rows: slice, out: Image | None = None) -> Image:
        """Return the dot products of some rows, in `out` if given."""
        return np.add(self.rows[rows], self.columns, out=out)


class Rays:
    """Rays (x, y, 1) of all pixels of an area, linear in the pixel position.

    Distortion bends them by less than 0.1 px over a sphere's image, which is negligible for shading; at a rim
    the exact rays of the lens are used instead. Being linear, a dot product with a fixed vector is the sum of
    a row and a column, one operation per pixel.
    """

    def __init__(self, lens: Lens, area: Area) -> None:
        self.area = area
        x, y = area.x + (area.width - 1) / 2, area.y + (area.height - 1) / 2
        probe = lens.rays([[x, y], [x + 1, y], [x, y + 1]])
        self._origin = np.append(probe[0], 1.0)
        self._per_column = np.append(probe[1] - probe[0], 0.0)
        self._per_row = np.append(probe[2] - probe[0], 0.0)
        self._columns = np.arange(area.width) - (area.width - 1) / 2
        self._rows = np.arange(area.height) - (area.height - 1) / 2

    def dot(self, vector: NDArray[np.float64]) -> Dot:
        """Compute the dot product of a vector (3,) with each ray."""
        columns = self._columns * (self._per_column @ vector) + self._origin @ vector
        rows = self._rows * (self._per_row @ vector)
        return Dot(rows.astype(np.float32)[:, None], columns.astype(np.float32)[None, :])

    def square_rows(self, rows: slice, out: Image | None = None) -> Image:
        """Return the squared ray lengths of some rows, in `out` if given."""
        along_x, along_y = self._along_axes
        x, y = along_x.sum_rows(rows, out), along_y.sum_rows(rows)
        x *= x
        y *= y
        x += y
        x += np.float32(1.0)
        return x

    @cached_property
    def _along_axes(self) -> tuple[Dot, Dot]:
        return self.dot(np.array([1.0, 0.0, 0.0])), self.dot(np.array([0.0, 1.0, 0.0]))


def spread_px(sigma_px: float) -> int:
    """Return the distance in pixels over which the blur spreads light."""
    return ceil(SPREAD_SIGMAS * sigma_px) + 1


def blur(patch: Image, sigma_px: float) -> Image:
    """Convolve a patch (rows, columns) with a Gaussian, extending its border outwards."""
    if sigma_px <= KERNEL_LIMIT_PX:
        spread = spread_px(sigma_px)
        steps = np.arange(-spread, spread + 1)
        kernel = np.exp(-0.5 * (steps / sigma_px) ** 2)
        kernel = (kernel / kernel.sum()).astype(np.float32)
        return _convolve(patch, kernel)
    # Variance of a box of w pixels is (w^2 - 1) / 12; three of them add up. Only odd widths stay centred.
    ideal = (4.0 * sigma_px**2 + 1.0) ** 0.5
    small = int(ideal) - (1 - int(ideal) % 2)
    # number of boxes of the smaller width for which the total variance is nearest to the target
    count = round((12 * sigma_px**2 - 3 * (small * small + 4 * small + 3)) / (-4 * small - 4))
    for index in range(3):
        width = small if index < count else small + 2
        patch = _box_filter(_box_filter(patch, width, 0), width, 1)
    return patch


def _convolve(patch: Image, kernel: Image) -> Image:
    """Convolve along the columns, then along the rows, a few rows at a time."""
    spread = len(kernel) // 2
    padded = _extend_edge(patch, spread, 0)
    smooth = np.empty_like(patch)
    for rows in row_bands(*patch.shape):
        down = _convolve_axis(padded[rows.start : rows.stop + 2 * spread], kernel, 0)
        _convolve_axis(_extend_edge(down, spread, 1), kernel, 1, smooth[rows])
    return smooth


def _convolve_axis(padded: Image, kernel: Image, axis: int, out: Image | None = None) -> Image:
    """Convolve along one axis, which shrinks by the kernel length minus one; writes to `out` if given."""
    spread = len(kernel) // 2
    length = padded.shape[axis] - 2 * spread

    def view_from(step: int) -> Image:
        return padded[step : step + length] if axis == 0 else padded[:, step : step + length]

    total: Image = np.multiply(view_from(spread), kernel[spread], out=out)
    pair = np.empty_like(total)
    for step in range(spread):  # the kernel is symmetric: one multiplication for two taps
        np.add(view_from(step), view_from(2 * spread - step), out=pair)
        pair *= kernel[step]
        total += pair
    return total


def _box_filter(patch: Image, width: int, axis: int) -> Image:
    spread = width // 2
    sums: NDArray[np.float64] = np.cumsum(_extend_edge(patch, spread, axis), axis=axis, dtype=np.float64)
    first = np.zeros_like(sums[:1] if axis == 0 else sums[:, :1])
    sums = np.concatenate([first, sums], axis=axis)
    ends = sums[width:] - sums[:-width] if axis == 0 else sums[:, width:] - sums[:, :-width]
    return (ends / width).astype(np.float32)


def _extend_edge(patch: Image, spread: int, axis: int) -> Image:
    height, width = patch.shape
    if axis == 0:
        padded: Image = np.empty((height + 2 * spread, width), patch.dtype)
        padded[spread : spread + height] = patch
        padded[:spread], padded[spread + height :] = patch[:1], patch[-1:]
    else:
        padded = np.empty((height, width + 2 * spread), patch.dtype)
        padded[:, spread : spread + width] = patch
        padded[:, :spread], padded[:, spread + width :] = patch[:, :1], patch[:, -1:]
    return padded
