"""Image painting: bodies, the scanner's exact blur and metal streaks."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, erf, exp, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.shapes import Ball, Shape, Values
from sim.world.rigid import Point

PLANE_SIGMA_MM = 0.42  # in the slice: 1 mm full width at half maximum
SLICE_SIGMA_MM = 0.35  # along z, before the slice's own thickness
SPREAD_SIGMAS = 4.0
BOX_VARIANCE = 1.0 / 12.0  # of a box of unit width

Matrix = NDArray[np.float32]

FILLING_HU = 250.0  # next to the metal
FILLING_FALL_MM = 6.0  # beyond this, streaks fade with the inverse of the distance
FILLING_LOBES = 7
BAND_FADES = 0.25  # width of its fading ends, relative to its half length
FAINTEST = 1e-3  # value of a streak's height profile below which a slice is left unchanged


def paint(image: Values, axes: tuple[Values, Values, Values], shape: Shape, edge_mm: float) -> None:
    """Paint a body into `image` (z, y, x), sampled at ascending coordinates `axes` = (x, y, z).

    Within `edge_mm` across its surface the body blends into the previous content.
    """
    low, high = shape.bounds()
    margin = np.float32(0.5 * edge_mm)
    parts = []
    # z first: of most slices a body is above or below
    for axis, lowest, highest in zip(reversed(axes), reversed(low), reversed(high), strict=True):
        first = int(np.searchsorted(axis, lowest - margin))
        last = int(np.searchsorted(axis, highest + margin))
        if first >= last:
            return
        parts.append(slice(first, last))
    z, y, x = (axis[part] for axis, part in zip(reversed(axes), parts, strict=True))
    depth = shape.depth(x[None, None, :], y[None, :, None], z[:, None, None])
    cover = np.clip(depth * np.float32(1.0 / edge_mm) + np.float32(0.5), np.float32(0.0), np.float32(1.0))
    region = image[tuple(parts)]
    region += (np.float32(shape.hu) - region) * cover


def blur_weights(
    voxels_mm: NDArray[np.float64], spacing_mm: float, fine_mm: NDArray[np.float64], sigma_mm: float
) -> Matrix:
    """Return normalised weights (voxels, fine samples) for averaging fine samples into blurred voxels.

    A voxel is the average, over its box, of the object blurred by a Gaussian: the weight of a fine sample is
    the Gaussian integrated over the voxel, so the blur costs one matrix product per axis.
    """
    edges = (fine_mm[None, :] - voxels_mm[:, None] + 0.5 * spacing_mm) / (sqrt(2.0) * sigma_mm)
    other = (fine_mm[None, :] - voxels_mm[:, None] - 0.5 * spacing_mm) / (sqrt(2.0) * sigma_mm)
    raw = _erf(edges) - _erf(other)
    rows: Matrix = (raw / raw.sum(axis=1, keepdims=True)).astype(np.float32)
    return rows


def blur_spread_mm(spacing_mm: float, sigma_mm: float) -> float:
    """Return the distance from a voxel's centre within which an object affects it."""
    return SPREAD_SIGMAS * sigma_mm + 0.5 * spacing_mm


def edge_sigma_mm(pixel_mm: float, slice_mm: float, plane_sigma_mm: float = PLANE_SIGMA_MM) -> float:
    """Return the standard deviation of edge blur, averaged over the slice plane and z."""
    plane = plane_sigma_mm**2 + BOX_VARIANCE * pixel_mm**2
    along = SLICE_SIGMA_MM**2 + BOX_VARIANCE * slice_mm**2
    return sqrt((2.0 * plane + along) / 3.0)


def _erf(values: NDArray[np.float64]) -> NDArray[np.float64]:
    # values repeat from voxel to voxel, and there are few: not worth importing SciPy
    result: NDArray[np.float64] = np.vectorize(erf, otypes=[float])(values)
    return result


@dataclass(frozen=True)
class Streak:
    """Lobed streaks around a piece of metal, with standard deviation `height_mm` along z."""

    centre: Point
    hu: float
    fall_mm: float
    lobes: int
    phase_rad: float
    height_mm: float


@dataclass(frozen=True)
class Band:
    """A straight streak through a slice, as between pieces of metal, with widths as standard deviations.

    It passes `centre` along `angle_rad` from x, and keeps its strength up to `half_length_mm` from it.
    """

    centre: Point
    hu: float
    angle_rad: float
    width_mm: float
    height_mm: float
    half_length_mm: float


def add_band(image: Values, x: Values, y: Values, z_mm: float, band: Band) -> None:
    """Add a band to a slice, fading along z."""
    share = exp(-0.5 * ((z_mm - band.centre[2]) / band.height_mm) ** 2)
    if share < FAINTEST:
        return
    dx, dy = x[None, :] - np.float32(band.centre[0]), y[:, None] - np.float32(band.centre[1])
    across = np.float32(cos(band.angle_rad)) * dy - np.float32(sin(band.angle_rad)) * dx
    along = np.float32(cos(band.angle_rad)) * dx + np.float32(sin(band.angle_rad)) * dy
    share_past_end = np.maximum(np.abs(along) / np.float32(band.half_length_mm) - 1.0, np.float32(0.0))
    square = (across / np.float32(band.width_mm)) ** 2 + (share_past_end / np.float32(BAND_FADES)) ** 2
    image += np.float32(share * band.hu) * np.exp(np.float32(-0.5) * square)


def add_filling_streaks(image: Values, x: Values, y: Values, z_mm: float, filling: Ball) -> None:
    """Add rays to the slices through a dental filling."""
    if abs(z_mm - filling.centre[2]) <= filling.radius:
        lobes = Streak(filling.centre, FILLING_HU, FILLING_FALL_MM, FILLING_LOBES, filling.centre[0], 1.0)
        _add_lobes(image, x, y, lobes, FILLING_HU)


def add_streak(image: Values, x: Values, y: Values, z_mm: float, streak: Streak) -> None:
    """Add streak lobes to a slice, fading smoothly along z."""
    share = exp(-0.5 * ((z_mm - streak.centre[2]) / streak.height_mm) ** 2)
    if share > FAINTEST:
        _add_lobes(image, x, y, streak, share * streak.hu)


def _add_lobes(image: Values, x: Values, y: Values, streak: Streak, hu: float) -> None:
    dx, dy = x[None, :] - np.float32(streak.centre[0]), y[:, None] - np.float32(streak.centre[1])
    distance = np.maximum(np.sqrt(dx * dx + dy * dy), np.float32(streak.fall_mm))
    strength = np.float32(hu * streak.fall_mm) / distance
    image += strength * np.sin(np.float32(streak.lobes) * np.arctan2(dy, dx) + np.float32(streak.phase_rad))
