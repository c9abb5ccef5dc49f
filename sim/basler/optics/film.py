"""Surface of a sphere: retro-reflective film with grain and stains.

Blood and liquid stop the beads from reflecting the light. Both cameras see the same stains, each from its
side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Image
from sim.world.noise import noise

BEAD_MM = 0.05  # beads of retro-reflective film are 40 to 70 um
CONTRAST = 0.04  # standard deviation of the brightness
TABLE_SIZE = 1 << 16
# odd multipliers that spread neighbouring cubes over the table (Fibonacci hashing, one per axis)
MULTIPLIERS = (np.int32(0x1E3779B1), np.int32(0x05EBCA77), np.int32(0x42B2AE3D))

STAINED_BRIGHTNESS = 0.3  # relative to clean film: light passes the stain twice
STAIN_EDGE_MM = 0.04  # a drop dries with a soft edge
SMALLEST_RAD, LARGEST_RAD = 0.05, 0.15  # half the angle of a spot, from the sphere's centre


class Film:
    """Film of one sphere: its grain, darkened by stains."""

    def __init__(self, grain: Grain, radius_mm: float, stains: Sequence[Stain] = ()) -> None:
        self._grain = grain
        self._stains = stains
        self._radius_mm = radius_mm

    def brightness_at(self, x_mm: Image, y_mm: Image, z_mm: Image) -> Image:
        """Return the brightness factor (mean 1 on clean film) at surface points in the sphere's frame."""
        light = self._grain.brightness_at(x_mm, y_mm, z_mm)
        for stain in self._stains:
            x, y, z = (np.float32(part) for part in stain.direction)
            height = x_mm * x
            height += y_mm * y
            height += z_mm * z
            # height above the plane of the spot's edge; across the edge it grows by the sine of the angle
            plane_mm = self._radius_mm * np.cos(stain.half_angle_rad)
            soft_mm = STAIN_EDGE_MM * np.sin(stain.half_angle_rad)
            spot = np.nonzero(height > np.float32(plane_mm - soft_mm / 2))
            cover = np.clip((height[spot] - plane_mm) / soft_mm + 0.5, 0.0, 1.0)
            light[spot] *= (1.0 - (1.0 - STAINED_BRIGHTNESS) * cover).astype(light.dtype)
        return light


@dataclass(frozen=True)
class Stain:
    """A round stain, given by its angular radius and the direction of its centre in the sphere's frame."""

    direction: tuple[float, float, float]
    half_angle_rad: float

    def may_be_visible(self, to_camera: NDArray[np.float64]) -> bool:
        """Return whether part of the stain may face `to_camera`, a unit vector in the sphere's frame."""
        return bool(np.dot(self.direction, to_camera) > -np.sin(self.half_angle_rad))


@cache
def draw_stains(seed: int, number: int, share: float) -> tuple[Stain, ...]:
    """Draw possibly overlapping stains until their total area reaches `share` of the sphere's surface."""
    generator = noise(seed, f"stains of sphere {number}", 0)
    stains: list[Stain] = []
    covered = 0.0
    while covered < share:
        x, y, z = generator.standard_normal(3)
        length = float(np.sqrt(x * x + y * y + z * z))
        half_angle = float(generator.uniform(SMALLEST_RAD, LARGEST_RAD))
        stains.append(Stain((float(x) / length, float(y) / length, float(z) / length), half_angle))
        covered += (1.0 - float(np.cos(half_angle))) / 2.0
    return tuple(stains)


class Grain:
    """Film grain: glass beads, each slightly brighter or darker than the mean.

    Space is divided into cubes of a bead's size, fixed to the sphere, and a bead's brightness is derived from
    its cube: the grain moves with the sphere, and the same sphere always looks the same.
    """

    def __init__(self, seed: int, number: int) -> None:
        values = noise(seed, f"film of sphere {number}", 0).standard_normal(TABLE_SIZE, dtype=np.float32)
        self._table: Image = np.float32(1.0) + np.float32(CONTRAST) * values

    def brightness_at(self, x_mm: Image, y_mm: Image, z_mm: Image) -> Image:
        """Return the brightness factor (mean 1) at surface points in the sphere's frame."""
        total: NDArray[np.int32] = np.zeros(x_mm.shape, dtype=np.int32)
        beads, cube = np.empty_like(x_mm), np.empty_like(total)
        for position, multiplier in zip((x_mm, y_mm, z_mm), MULTIPLIERS, strict=True):
            np.multiply(position, np.float32(1.0 / BEAD_MM), out=beads)
            np.floor(beads, out=beads)
            np.copyto(cube, beads, casting="unsafe")
            cube *= multiplier  # wraps around, as a hash should
            total ^= cube
        total >>= 12
        total &= TABLE_SIZE - 1
        return self._table.take(total)
