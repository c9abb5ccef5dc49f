"""Tracker measurement errors: noise and bias of single markers, phantom markers and additional strays.

Tracker frame, mm. The stereo base is half a metre. The error in depth is three to four times that of the
other two axes; all grow with the square of the distance. Phantom markers are intersections of the
rays of different markers: stereo matching cannot distinguish two markers in one epipolar plane, and finds up
to two positions besides the true ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from sim.polaris.unit.model import UnitVolume
from sim.world.noise import noise
from sim.world.rigid import Vectors
from sim.world.scene.model import TrackerTruth

WAVES = 8
WAVELENGTH_MM = (1500.0, 3000.0)  # longer than any tool: neighbouring markers share their bias
DEPTH_RATIO = 2.0  # z component of the field relative to x and y
GRID_POINTS = 15  # per axis, used to scale the field
POWER_RANGE = (-6.0, 6.0)
POWER_STEPS = 20  # bisections

HALF_BASE_MM = 250.0  # the sensors are on y, left and right of the origin
EYES_MM: NDArray[np.float64] = np.array([[0.0, -HALF_BASE_MM, 0.0], [0.0, HALF_BASE_MM, 0.0]])
# Field of view of both sensors: not public; it only has to contain every volume.
FIELD_DEPTHS_MM = (300.0, 4000.0)
FIELD_SLOPES = (tan(radians(27.0)), tan(radians(32.0)))  # largest |x| and |y| per depth
Flags = NDArray[np.bool_]

INNER_SHARE = 0.7  # share of the volume's depth and width that holds additional strays
REFLECTION_PRESENCE = 0.3  # share of frames in which a reflection is bright enough
REFLECTION_SPREAD_MM = 3.0  # a reflection wanders over its surface
SPHERES, REFLECTIONS = "tracker extra spheres", "tracker reflections"


@dataclass(frozen=True)
class Sight:
    """Mean and standard deviation of n measured points, both (n, 3)."""

    mean_mm: Vectors
    sigma_mm: Vectors

    def measured(self, standard_normal: Vectors) -> Vectors:
        """Return one measurement (n, 3), given standard normal deviates (n, 3)."""
        return self.mean_mm + self.sigma_mm * standard_normal


class Optics:
    """Sensor pair, with the scene's noise stated for the centre of the unit's first volume."""

    def __init__(self, truth: TrackerTruth, seed: int, volumes: tuple[UnitVolume, ...]) -> None:
        self._sigma_mm = np.array([truth.noise_xy_mm, truth.noise_xy_mm, truth.noise_z_mm])
        self._middle_mm = volumes[0].middle_depth_mm
        given_mm = (truth.bias_mm, truth.bias_extended_mm)
        self.bias_field = bias_field(
            seed,
            tuple(
                (volume, volume.stated_mm if bias_mm is None else bias_mm)
                for volume, bias_mm in zip(volumes, given_mm, strict=False)
            ),
        )

    def sight(self, points_mm: Vectors) -> Sight:
        """Return the mean and noise of markers at `points_mm` (n, 3)."""
        if not len(points_mm):
            return Sight(points_mm, points_mm)
        growth = (points_mm[:, 2:] / self._middle_mm) ** 2
        return Sight(points_mm + self.bias_field.error_at(points_mm), growth * self._sigma_mm)


def is_in_field(points_mm: Vectors) -> NDArray[np.bool_]:
    """Return flags (n,) for whether each point (n, 3) is in both sensors' field of view."""
    x, y, z = points_mm.T
    nearest, farthest = FIELD_DEPTHS_MM
    slope_x, slope_y = FIELD_SLOPES
    field: NDArray[np.bool_] = (
        (-z >= nearest) & (-z <= farthest) & (np.abs(x) <= -z * slope_x) & (np.abs(y) <= -z * slope_y)
    )
    return field


def phantoms(eyes_mm: Vectors, points_mm: Vectors, seen: Flags, line_separation_mm: float) -> Vectors:
    """Return phantoms (m, 3) of markers (n, 3), with `seen` (2, n) per sensor and marker.

    Rays closer than `line_separation_mm` intersect, midway between them.
    """
    return crossings(eyes_mm, points_mm, seen, line_separation_mm)[1]


def crossings(
    eyes_mm: Vectors, points_mm: Vectors, seen: Flags, line_separation_mm: float
) -> tuple[NDArray[np.intp], Vectors]:
    """Return the markers (m, 2) whose rays intersect, left sensor's first, and where (m, 3)."""
    left, right = np.nonzero(seen[0])[0], np.nonzero(seen[1])[0]
    if line_separation_mm <= 0.0 or len(left) < 1 or len(right) < 1:
        return np.empty((0, 2), dtype=np.intp), np.empty((0, 3))
    first, second = np.repeat(left, len(right)), np.tile(right, len(left))
    different = first != second
    first, second = first[different], second[different]
    a, b = points_mm[first] - eyes_mm[0], points_mm[second] - eyes_mm[1]
    base = eyes_mm[0] - eyes_mm[1]
    # Ray parameters at closest approach; nearly parallel rays do not intersect within the field of view.
    aa, bb, ab = ((u * v).sum(axis=1) for u, v in ((a, a), (b, b), (a, b)))
    ad, bd = a @ base, b @ base
    determinant = aa * bb - ab * ab
    apart = determinant > 1e-9 * aa * bb
    determinant = np.where(apart, determinant, 1.0)
    on_a = base / 2.0 + ((ab * bd - bb * ad) / determinant)[:, None] * a
    on_b = -base / 2.0 + ((aa * bd - ab * ad) / determinant)[:, None] * b
    gap = on_a - on_b
    meet = apart & ((gap * gap).sum(axis=1) <= line_separation_mm**2)
    middle = (eyes_mm[0] + eyes_mm[1]) / 2.0 + (on_a[meet] + on_b[meet]) / 2.0
    inside = is_in_field(middle)
    return np.stack([first[meet][inside], second[meet][inside]], axis=1), middle[inside]


@lru_cache(maxsize=8)
def extra_strays(seed: int, count: int, volume: UnitVolume) -> Vectors:
    """Return positions (n, 3) of fault-induced spheres, keeping earlier positions as the count grows."""
    return _draw_places(seed, SPHERES, count, volume)


@lru_cache(maxsize=8)
def reflecting_places(seed: int, count: int, volume: UnitVolume) -> Vectors:
    """Return positions (n, 3) of flickering reflective surfaces."""
    return _draw_places(seed, REFLECTIONS, count, volume)


def reflections(places_mm: Vectors, generator: np.random.Generator) -> Vectors:
    """Return the reflections (m, 3) seen in one frame."""
    shines = generator.random(len(places_mm)) < REFLECTION_PRESENCE
    wandered = places_mm + generator.normal(0.0, REFLECTION_SPREAD_MM, places_mm.shape)
    return wandered[shines]


def _draw_places(seed: int, what: str, count: int, volume: UnitVolume) -> Vectors:
    near, far = volume.depths_mm
    middle, half = (near + far) / 2.0, INNER_SHARE * (far - near) / 2.0
    places = np.empty((count, 3))
    for index in range(count):
        x, y, z = noise(seed, what, index).uniform(-1.0, 1.0, 3)
        depth_mm = middle + half * z
        half_x, half_y = volume.half_widths_mm(depth_mm)
        places[index] = (INNER_SHARE * half_x * x, INNER_SHARE * half_y * y, -depth_mm)
    return places


class BiasField:
    """Systematic error of the unit: a fixed, smooth field over the volume.

    A sum of plane waves drawn from the seed, times a power of the depth. Amplitude and power give the field
    the stated rms length over each of two volumes: what data sheets call volumetric accuracy, the mean error
    of many readings of a stationary marker.
    """

    def __init__(self, seed: int, stated: tuple[tuple[UnitVolume, float], ...]) -> None:
        """Fit to `stated`: one or two volumes, smaller first, each with its rms error length in mm."""
        generator = noise(seed, "tracker bias", 0)
        directions = generator.standard_normal((WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._waves = 2.0 * np.pi * directions / generator.uniform(*WAVELENGTH_MM, (WAVES, 1))
        self._phases = generator.uniform(0.0, 2.0 * np.pi, WAVES)
        self._amplitudes_mm = generator.standard_normal((WAVES, 3)) * (1.0, 1.0, DEPTH_RATIO)
        self._middle_mm = stated[0][0].middle_depth_mm
        self._power = 0.0
        sizes = [
            _Sizes(self.error_at(grid), self._depths(grid))
            for grid in (_grid(volume) for volume, _ in stated)
        ]
        if len(stated) > 1 and stated[0][1] > 0.0:
            self._power = _fit_power(sizes[0], sizes[1], stated[1][1] / stated[0][1])
        self._amplitudes_mm *= stated[0][1] / sizes[0].rms(self._power)

    def error_at(self, points_mm: Vectors) -> Vectors:
        """Return the error (n, 3) at the given points (n, 3)."""
        waves = np.sin(points_mm @ self._waves.T + self._phases) @ self._amplitudes_mm
        return waves * self._depths(points_mm)[:, None] ** self._power

    def _depths(self, points_mm: Vectors) -> Vectors:
        return np.abs(points_mm[:, 2]) / self._middle_mm


@cache
def bias_field(seed: int, stated: tuple[tuple[UnitVolume, float], ...]) -> BiasField:
    """Return the bias field, cached because fitting its power dominates a unit's start-up time."""
    return BiasField(seed, stated)


class _Sizes:
    """Rms length, over a volume, of a field scaled by a power of depth."""

    def __init__(self, field: Vectors, depths: Vectors) -> None:
        self._squares = (field * field).sum(axis=1)
        self._depths = depths

    def rms(self, power: float) -> float:
        return float(np.sqrt(np.mean(self._squares * self._depths ** (2.0 * power))))


def _fit_power(small: _Sizes, large: _Sizes, ratio: float) -> float:
    """Find by bisection the power of depth that yields the given ratio of rms lengths."""
    low, high = POWER_RANGE
    for _ in range(POWER_STEPS):
        middle = (low + high) / 2.0
        if large.rms(middle) < ratio * small.rms(middle):
            low = middle
        else:
            high = middle
    return (low + high) / 2.0


@cache
def _grid(volume: UnitVolume) -> Vectors:
    """Return read-only points (n, 3) spread evenly over the volume."""
    near, far = volume.depths_mm
    x, y = volume.half_widths_mm(far)
    middles = (np.arange(GRID_POINTS) + 0.5) / GRID_POINTS
    axes = [low + (high - low) * middles for low, high in ((-x, x), (-y, y), (-far, -near))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = [volume.holds(*point) for point in points.tolist()]
    grid: Vectors = points[np.array(inside)]
    grid.flags.writeable = False
    return grid
