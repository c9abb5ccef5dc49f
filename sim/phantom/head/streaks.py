"""Metal artefacts: dark and bright rays in the slices with metal, fading with distance."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, sin

import numpy as np

from sim.phantom.head.shapes import Ball, Point, Values

FILLING_HU = 250.0  # next to the metal
FILLING_FALL_MM = 6.0  # beyond this, streaks fade with the inverse of the distance
FILLING_LOBES = 7
BAND_FADES = 0.25  # of its half length
FAINTEST = 1e-3  # of a streak's height profile; below this the slice is left unchanged


@dataclass(frozen=True)
class Streak:
    """Lobes around a piece of metal; `height_mm` is the standard deviation of their extent along z."""

    centre: Point
    hu: float
    fall_mm: float
    lobes: int
    phase_rad: float
    height_mm: float


@dataclass(frozen=True)
class Band:
    """A straight streak through a slice, as between two pieces of metal; widths are standard deviations.

    It passes `centre` along `angle_rad` from x, and keeps its strength up to `half_length_mm` from it.
    """

    centre: Point
    hu: float
    angle_rad: float
    width_mm: float
    height_mm: float
    half_length_mm: float


def add_band(image: Values, x: Values, y: Values, z_mm: float, band: Band) -> None:
    """Add it to a slice; it fades along z."""
    share = exp(-0.5 * ((z_mm - band.centre[2]) / band.height_mm) ** 2)
    if share < FAINTEST:
        return
    dx, dy = x[None, :] - np.float32(band.centre[0]), y[:, None] - np.float32(band.centre[1])
    across = np.float32(cos(band.angle_rad)) * dy - np.float32(sin(band.angle_rad)) * dx
    along = np.float32(cos(band.angle_rad)) * dx + np.float32(sin(band.angle_rad)) * dy
    beyond = np.maximum(np.abs(along) / np.float32(band.half_length_mm) - 1.0, np.float32(0.0))
    square = (across / np.float32(band.width_mm)) ** 2 + (beyond / np.float32(BAND_FADES)) ** 2
    image += np.float32(share * band.hu) * np.exp(np.float32(-0.5) * square)


def add_filling_streaks(image: Values, x: Values, y: Values, z_mm: float, filling: Ball) -> None:
    """Rays in the slices through a filling."""
    if abs(z_mm - filling.centre[2]) <= filling.radius:
        lobes = Streak(filling.centre, FILLING_HU, FILLING_FALL_MM, FILLING_LOBES, filling.centre[0], 1.0)
        _add(image, x, y, lobes, FILLING_HU)


def add_streak(image: Values, x: Values, y: Values, z_mm: float, streak: Streak) -> None:
    """Rays that fade smoothly along z."""
    share = exp(-0.5 * ((z_mm - streak.centre[2]) / streak.height_mm) ** 2)
    if share > FAINTEST:
        _add(image, x, y, streak, share * streak.hu)


def _add(image: Values, x: Values, y: Values, streak: Streak, hu: float) -> None:
    dx, dy = x[None, :] - np.float32(streak.centre[0]), y[:, None] - np.float32(streak.centre[1])
    distance = np.maximum(np.sqrt(dx * dx + dy * dy), np.float32(streak.fall_mm))
    strength = np.float32(hu * streak.fall_mm) / distance
    image += strength * np.sin(np.float32(streak.lobes) * np.arctan2(dy, dx) + np.float32(streak.phase_rad))
