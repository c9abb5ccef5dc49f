"""Metal artefacts: dark and bright rays in the slices with metal, fading with distance."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np

from sim.phantom.head.shapes import Ball, Point, Values

FILLING_HU = 250.0  # beside the metal
FILLING_FALL_MM = 6.0  # beyond it streaks fade with the inverse of the distance
FILLING_LOBES = 7
FAINTEST = 1e-3  # of a streak's height profile; below it the slice is left alone


@dataclass(frozen=True)
class Streak:
    """Lobes around a piece of metal; `height_mm` is the standard deviation of their extent along z."""

    centre: Point
    hu: float
    fall_mm: float
    lobes: int
    phase_rad: float
    height_mm: float


def add_filling_streaks(image: Values, x: Values, y: Values, z_mm: float, filling: Ball) -> None:
    """Rays in the slices that cut through a filling."""
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
