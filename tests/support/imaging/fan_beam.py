"""A second scanner for spheres on metal: a fan of rays, another spectrum, direct fan-beam reconstruction.

It shares neither geometry nor spectrum nor code with the phantom's scanner.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.imaging import Volume, VoxelGeometry
from ronna_hw.arrays import Array

# NIST mass attenuation (cm2/g) at 50, 80 and 100 keV
WATER = np.array([0.2269, 0.1837, 0.1707])
METALS = {
    "titanium": 4.51 * np.array([1.213, 0.4052, 0.2721]),
    "steel": 7.9 * np.array([1.958, 0.5952, 0.3717]),
}
SPECTRUM = np.array([0.45, 0.35, 0.20])
POLYMER = 1.12  # g/cm3, attenuating like water
SOURCE_MM, VIEWS, PHOTONS = 570.0, 360, 1e5
RAY_RAD = 0.4 / SOURCE_MM
PIXEL_MM, SLICE_MM, SIDE, SLICES = 0.5, 1.0, 72, 26
BLUR_MM, WATER_MM = 0.42, 22.0


@dataclass(frozen=True)
class Mounted:
    """A ball at `centre` (x, y, z) whose screw runs along the unit vector `down`, on a flange."""

    centre: tuple[float, float, float]
    down: tuple[float, float, float]
    metal: str
    ball_mm: float = 5.75
    screw_mm: float = 1.6
    flange_mm: float = 1.6
    flange_below_mm: float = 11.0


def scan(*mounted: Mounted, seed: int = 0) -> Volume:
    """Project and reconstruct balls on their metal, over water, as a volume in LPS mm."""
    random = np.random.default_rng(seed)
    fan = RAY_RAD * (np.arange(260) - 129.75)  # a quarter of a ray off the middle, as scanners have it
    half_mm = 0.5 * (SIDE - 1) * PIXEL_MM
    places = np.linspace(-half_mm, half_mm, SIDE).astype(np.float32)
    heights = SLICE_MM * (np.arange(SLICES) - 0.5 * (SLICES - 1))
    angles = 2.0 * np.pi * np.arange(VIEWS) / VIEWS
    voxels = np.empty((SLICES, SIDE, SIDE), dtype=np.int16)
    for number, height in enumerate(heights.tolist()):
        through = np.mean(
            [_transmit(mounted, z, angles, fan) for z in height + np.array([-0.3, 0.0, 0.3])], 0
        )
        counted = np.maximum(random.poisson(PHOTONS * through), 1) / PHOTONS
        hu = 1000.0 * (_reconstruct(_as_water(counted), angles, fan, places) - 1.0)
        voxels[number] = np.clip(np.rint(hu), -1024, 3071)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    first = np.array([-half_mm, -half_mm, heights[0]])
    geometry = VoxelGeometry(voxels.shape, first, axes, np.array([SLICE_MM, PIXEL_MM, PIXEL_MM]))
    voxels.flags.writeable = False
    return Volume(voxels, geometry, "1.2.3", "1.2.4")


def _transmit(mounted: tuple[Mounted, ...], z: float, angles: Array, fan: Array) -> Array:
    """Return the transmitted share of the photons (views, rays) at a height."""
    source = SOURCE_MM * np.column_stack((np.cos(angles), np.sin(angles), np.zeros_like(angles)))
    source[:, 2] = z
    heading = angles[:, None] + np.pi + fan
    ray = np.stack((np.cos(heading), np.sin(heading), np.zeros_like(heading)), axis=-1)
    exponents = sum(_attenuate(one, source, ray) for one in mounted)
    return np.asarray(np.exp(-exponents) @ SPECTRUM)


def _attenuate(mounted: Mounted, source: Array, ray: Array) -> Array:
    """Return the exponents (views, rays, energies) of a ball with its screw and flange, and water below."""
    centre, down = np.array(mounted.centre), np.array(mounted.down)
    water = POLYMER * _chord_of_ball(source, ray, centre, mounted.ball_mm)
    water += _chord_of_ball(source, ray, centre + (mounted.flange_below_mm + 24.0) * down, WATER_MM)
    screw = _ends_of_cylinder(
        source, ray, centre + (mounted.ball_mm - 1.5) * down, down, 19.0, mounted.screw_mm
    )
    flange = _ends_of_cylinder(
        source, ray, centre + mounted.flange_below_mm * down, down, mounted.flange_mm, 4.0
    )
    shared = np.minimum(screw[1], flange[1]) - np.maximum(screw[0], flange[0])
    metal = (screw[1] - screw[0]) + (flange[1] - flange[0]) - np.maximum(shared, 0.0)
    return np.multiply.outer(0.1 * water, WATER) + np.multiply.outer(0.1 * metal, METALS[mounted.metal])


def _chord_of_ball(source: Array, ray: Array, centre: Array, radius: float) -> Array:
    offset = (centre - source)[:, None, :]
    along = (offset * ray).sum(axis=-1)
    return np.asarray(2.0 * np.sqrt(np.maximum(radius**2 - (offset**2).sum(axis=-1) + along**2, 0.0)))


def _ends_of_cylinder(
    source: Array, ray: Array, start: Array, axis: Array, length: float, radius: float
) -> tuple[Array, Array]:
    offset = (source - start)[:, None, :]
    lift, slope = offset @ axis, ray @ axis
    across, beside = ray - slope[..., None] * axis, offset - lift[..., None] * axis
    a = np.maximum((across**2).sum(axis=-1), 1e-9)
    b = (across * beside).sum(axis=-1)
    root = np.sqrt(np.maximum(b**2 - a * ((beside**2).sum(axis=-1) - radius**2), 0.0))
    slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
    caps = np.sort(np.stack((-lift / slope, (length - lift) / slope)), axis=0)
    low = np.maximum((-b - root) / a, caps[0])
    return low, np.maximum(low, np.minimum((-b + root) / a, caps[1]))


def _as_water(through: Array) -> Array:
    lengths = np.linspace(0.0, 700.0, 3000)  # mm
    logs = -np.log(np.exp(-np.outer(0.1 * lengths, WATER)) @ SPECTRUM)
    return np.interp(-np.log(through), logs, lengths)


def _reconstruct(water_mm: Array, angles: Array, fan: Array, places: NDArray[np.float32]) -> Array:
    """Reconstruct a slice (rows, columns) from a full turn of equiangular views; water is 1."""
    count = len(fan)
    steps = np.arange(1 - count, count)
    ramp = np.zeros(2 * count - 1)
    ramp[count - 1] = 0.125 / RAY_RAD**2
    odd = steps % 2 == 1
    ramp[odd] = -0.5 / (np.pi * np.sin(steps[odd] * RAY_RAD)) ** 2
    size = 1024
    transfer = np.abs(np.fft.rfft(np.roll(np.pad(ramp, (0, size - len(ramp))), 1 - count)))
    transfer *= np.exp(-2.0 * (np.pi * np.fft.rfftfreq(size, RAY_RAD * SOURCE_MM) * BLUR_MM) ** 2)
    weighted = water_mm * np.cos(fan) * SOURCE_MM * RAY_RAD
    views = np.fft.irfft(np.fft.rfft(weighted, size) * transfer, size)[:, :count].astype(np.float32)
    y, x = np.meshgrid(places, places, indexing="ij")
    picture = np.zeros(x.shape)
    for view, angle in zip(views, angles.tolist(), strict=True):
        c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        ahead, aside = np.float32(SOURCE_MM) - c * x - s * y, s * x - c * y
        column = np.arctan2(aside, ahead) / np.float32(RAY_RAD) - np.float32(fan[0] / RAY_RAD)
        seen = cv2.remap(view[None], column, np.zeros_like(column), cv2.INTER_LINEAR)
        picture += seen / (ahead**2 + aside**2)
    return picture * (2.0 * np.pi / len(angles))
