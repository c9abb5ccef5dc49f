"""Streaks and shadows of metal, from the physics of a scan: beam hardening and photon starvation.

The slice's tissue and the chords of every metal part are projected with a spectrum, through a detector of
finite width and a slice of finite thickness, with the few photons that the metal leaves. The scanner takes
the result for water, as scanners do. What this differs from the painted metal is reconstructed by filtered
back-projection and added to the slice, so tissue far from metal keeps every digit.

Rays are parallel: a scanner with a fan re-sorts its views to parallel ones before it reconstructs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import pi, sqrt
from mmap import mmap

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.anatomy import Anatomy
from sim.phantom.head.painting import BOX_VARIANCE, SLICE_SIGMA_MM
from sim.phantom.head.shapes import Ball, Rod, Shape, Values
from sim.phantom.scanner.faults import Kernel
from sim.phantom.scanner.fine_painting import part_between
from sim.phantom.scanner.grid import CtGrid
from sim.world.rigid import Array

MM_PER_CM = 10.0
HU_PER_WATER = 1000.0

# 120 kV, 10 degree tungsten anode, 8 mm of aluminium, 0.35 mm of Gd2O2S (model of Poludniowski and others,
# spekpy): mean energy in keV and share of the detected photons in seven bins
SPECTRUM_KEV = np.array([34.8, 45.1, 56.2, 65.2, 74.8, 88.7, 106.5])
SPECTRUM = np.array([0.0788, 0.1070, 0.2878, 0.2083, 0.1212, 0.1520, 0.0449])
# mass attenuation in cm2/g at 35, 45, 55, 65, 75, 90 and 110 keV: NIST XCOM, compounds by weight
WATER = np.array([0.3075, 0.2436, 0.2149, 0.1987, 0.1879, 0.1766, 0.1657])
BONE = np.array([0.8747, 0.5052, 0.3535, 0.2786, 0.2365, 0.2008, 0.1751])


@dataclass(frozen=True)
class Metal:
    """A metal: density in g/cm3, mass attenuation in cm2/g at the spectrum's energies."""

    density: float
    mass_attenuation: tuple[float, ...]

    @property
    def attenuation(self) -> Array:
        """Linear attenuation in 1/cm at the spectrum's energies."""
        return self.density * np.array(self.mass_attenuation)


TITANIUM, STEEL, AMALGAM = "titanium", "steel", "amalgam"
METALS: dict[str, Metal] = {
    TITANIUM: Metal(4.51, (3.2116, 1.6048, 0.9499, 0.6338, 0.4623, 0.3247, 0.2360)),
    # 70 % iron, 18 % chromium, 12 % nickel
    STEEL: Metal(7.95, (5.2511, 2.5981, 1.5062, 0.9764, 0.6882, 0.4580, 0.3109)),
    # 50 % mercury, 35 % silver, 9 % tin, 6 % copper
    AMALGAM: Metal(11.6, (21.036, 10.804, 6.3519, 4.0847, 2.8081, 4.3627, 2.6162)),
}

METAL_FROM_HU = 3000.0  # bodies painted at least this bright are metal
STEEL_FROM_HU = 5000.0
ABSENT_FROM_HU = 2500.0  # painted pixels above this belong to metal, whose chords are exact
BONE_FROM_HU = 300.0
BONE_EXCESS = 0.92  # g/cm3 of cortical bone over water (ICRP: 1.92)

RAY_MM = 0.35  # between rays; a clinical detector has 0.5 to 0.6 mm at the centre
APERTURE = (0.25, 0.5, 0.25)  # of focal spot and detector, over neighbouring rays: 0.6 mm
VIEWS = 480  # over half a turn: 0.65 mm apart at 100 mm from the metal, less than the blur
COARSE_MM, COARSE_VIEWS = 2.0, 60  # of the tissue, whose chords change slowly
FAR_MM, FAR_VIEWS = 2.0, 160  # of the picture away from the markers, where streaks are smooth
NEAR_MM = 12.0  # half side of the exact picture around a marker
INSIDE_MM = 5.0  # from a marker's centre: clear of its surface
DENSE_FROM_HU, METAL_REACH_MM = 900.0, 2.2  # nearer to metal, no localizer uses a pixel
HEIGHTS = 5  # within the slice profile
LEAST_NOISE_HU = 1.0  # a scan without noise has very many photons
HEAD_CM = 18.0  # of water, behind which the stated noise holds
LONGEST_CM = 60.0  # of water: range of the water correction
ELECTRONIC = 8.0  # photons: noise of the detector without any
PARALLEL = 1e-9  # stands for none between a ray and an axis
FEWEST = 1.0  # photons; a scanner stores no less


@dataclass(frozen=True)
class MetalPart:
    """A body of metal."""

    shape: Rod | Ball
    metal: Metal


def metal_parts(anatomy: Anatomy) -> tuple[MetalPart, ...]:
    """Return the rods and balls of metal in a head.

    Fillings are amalgam; what is painted brighter than titanium is steel. Cables and cups are left out.
    """
    fillings = set(anatomy.fillings)
    parts = []
    for shape in anatomy.shapes:
        if isinstance(shape, Rod | Ball) and shape.hu >= METAL_FROM_HU:
            steel = STEEL if shape.hu >= STEEL_FROM_HU else TITANIUM
            parts.append(MetalPart(shape, METALS[AMALGAM if shape in fillings else steel]))
    return tuple(parts)


class MetalArtefacts:
    """Adds the artefacts of metal parts to slices of a grid; thread-safe."""

    def __init__(
        self,
        parts: Sequence[MetalPart],
        near: Sequence[tuple[float, ...]],
        grid: CtGrid,
        kernel: Kernel,
        thickness_mm: float,
        noise_HU: float,
    ) -> None:
        self._parts = [(*_heights(part.shape), part) for part in parts]
        self._near = near
        self._grid = grid
        self._offsets_mm, self._weights = _slice_profile(thickness_mm)
        self._reach_mm = float(self._offsets_mm[-1])
        centre = (grid.x_mm.mean(), grid.y_mm.mean())
        self._centre_mm = np.array(centre)
        half_mm = 0.5 * float(np.hypot(grid.columns, grid.rows)) * grid.pixel_mm
        self._rays_mm: Array = np.float64(RAY_MM) * np.arange(
            -int(half_mm / RAY_MM), int(half_mm / RAY_MM) + 1
        )
        self._angles: Array = pi * np.arange(VIEWS, dtype=np.float64) / VIEWS
        sigma_mm = sqrt(kernel.plane_sigma_mm**2 + BOX_VARIANCE * grid.pixel_mm**2)
        shape = (grid.slices, len(near), 2)  # HU2 and pixels within markers
        shared = mmap(-1, max(1, np.prod(shape, dtype=int)) * np.dtype(np.float64).itemsize)
        self._squares = np.ndarray(shape, np.float64, shared)  # forks paint slices too
        self._filter = _filter(len(self._rays_mm), sigma_mm, kernel.enhanced)
        self._photons = _photons(noise_HU, sigma_mm)

    def strengths_HU(self) -> list[float]:
        """Return the rms artefact inside each marker, over the slices painted so far."""
        squares, pixels = self._squares.sum(axis=0).T
        return [float(one) for one in np.sqrt(squares / np.maximum(pixels, 1.0))]

    def add(self, image: Values, number: int, generator: np.random.Generator) -> None:
        """Add the artefacts of slice `number` to it (rows, columns) in HU."""
        z_mm = float(self._grid.z_mm[number])
        parts = [
            part for low, high, part in self._parts if low - self._reach_mm < z_mm < high + self._reach_mm
        ]
        shadow = self._mark_shadows(parts, z_mm)
        if not shadow.any():
            return
        view, ray = np.nonzero(shadow)
        chords = self._chords_cm(parts, z_mm, self._angles[view], self._rays_mm[ray])
        error = np.zeros(shadow.shape, dtype=np.float32)
        error[shadow] = self._error_cm(parts, chords, *self._tissue_cm(image, view, ray), generator)
        self._add_reconstruction(image, self._filtered(error), number)

    def _mark_shadows(self, parts: Sequence[MetalPart], z_mm: float) -> NDArray[np.bool_]:
        """Mark the rays (views, rays) that may meet metal."""
        directions = np.column_stack((np.cos(self._angles), np.sin(self._angles)))
        marked = np.zeros((VIEWS, len(self._rays_mm)), dtype=bool)
        for part in parts:
            ends = _ends_within(part.shape, z_mm - self._reach_mm, z_mm + self._reach_mm)
            if ends is None:
                continue
            places = directions @ (np.array(ends)[:, :2] - self._centre_mm).T
            low = places.min(axis=1) - part.shape.radius
            high = places.max(axis=1) + part.shape.radius
            marked |= (self._rays_mm > low[:, None]) & (self._rays_mm < high[:, None])
        return marked

    def _chords_cm(self, parts: Sequence[MetalPart], z_mm: float, angles: Array, rays_mm: Array) -> Array:
        """Return chords (heights, parts, rays) in cm, each length counted once where parts overlap."""
        cosine, sine = np.cos(angles), np.sin(angles)
        chords = np.empty((len(self._offsets_mm), len(parts), len(angles)))
        for heights, offset_mm in zip(chords, self._offsets_mm.tolist(), strict=True):
            taken: list[tuple[Array, Array]] = []
            for number, part in enumerate(parts):
                low, high = _chord_ends(part.shape, self._centre_mm, z_mm + offset_mm, cosine, sine, rays_mm)
                length = high - low
                for other_low, other_high in taken:
                    shared = np.minimum(high, other_high) - np.maximum(low, other_low)
                    length = length - np.maximum(shared, 0.0)
                heights[number] = np.maximum(length, 0.0) / MM_PER_CM
                taken.append((low, high))
        return chords

    def _tissue_cm(self, image: Values, view: NDArray[np.intp], ray: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return the water in cm, and the bone in excess of it in g/cm2, along rays (n,) of views (n,)."""
        import cv2

        step = max(1, round(COARSE_MM / self._grid.pixel_mm))
        tissue = np.where(image > ABSENT_FROM_HU, np.float32(-HU_PER_WATER), image)
        rows, columns = (-(-size // step) for size in image.shape)
        coarse = cv2.resize(tissue, (columns, rows), interpolation=cv2.INTER_AREA)
        water = np.clip(coarse / HU_PER_WATER + 1.0, 0.0, None)
        excess = np.where(coarse > BONE_FROM_HU, coarse / HU_PER_WATER, 0.0)
        bone = (excess * np.float32(BONE_EXCESS)).astype(np.float32)
        water = np.asarray(water - excess, dtype=np.float32)
        cell_mm = self._grid.columns * self._grid.pixel_mm / columns
        side = int(np.ceil(np.hypot(rows, columns)))
        middle = 0.5 * (side - 1)
        places_mm = (np.arange(side) - middle) * cell_mm
        sums = np.empty((2, COARSE_VIEWS + 1, len(self._rays_mm)))
        for turned in range(COARSE_VIEWS):
            turn = cv2.getRotationMatrix2D(
                (0.5 * (columns - 1), 0.5 * (rows - 1)), 180.0 * turned / COARSE_VIEWS, 1.0
            )
            turn[:, 2] += (middle - 0.5 * (columns - 1), middle - 0.5 * (rows - 1))
            for sort, content in enumerate((water, bone)):
                along = cv2.warpAffine(content, turn, (side, side)).sum(axis=0)
                sums[sort, turned] = np.interp(self._rays_mm, places_mm, along * cell_mm / MM_PER_CM)
        sums[:, -1] = sums[:, 0, ::-1]
        place = view * COARSE_VIEWS / VIEWS
        first = place.astype(int)
        share = place - first
        water_cm, bone_cm = ((1.0 - share) * one[first, ray] + share * one[first + 1, ray] for one in sums)
        return water_cm, bone_cm

    def _error_cm(
        self,
        parts: Sequence[MetalPart],
        chords: Array,
        water: Array,
        bone: Array,
        generator: np.random.Generator,
    ) -> Array:
        """Return what the rays (n,) show too much, in cm of water."""
        behind = SPECTRUM * np.exp(-np.outer(water, WATER) - np.outer(bone, BONE))  # (n, energies)
        alone = behind.sum(axis=1)
        attenuations = np.array([part.metal.attenuation for part in parts])
        through = np.zeros(len(water))
        for weight, lengths in zip(self._weights, chords, strict=True):
            through += weight * (behind * np.exp(-lengths.T @ attenuations)).sum(axis=1)
        painted = np.array([part.shape.hu / HU_PER_WATER + 1.0 for part in parts])
        shown_cm = np.tensordot(self._weights, chords, axes=1).T @ painted
        photons = self._photons * through
        # the noise that the ray has without metal is painted already
        extra = np.maximum(photons - photons**2 / (self._photons * alone), 0.0) + ELECTRONIC**2
        counted = photons + np.sqrt(extra) * generator.standard_normal(len(photons))
        measured = np.maximum(counted, FEWEST) / self._photons
        return np.asarray(_as_water_cm(measured) - _as_water_cm(alone) - shown_cm)

    def _filtered(self, error: Values) -> Values:
        """Filter all views (views, rays), in HU to be summed over the views."""
        from scipy import fft

        low, middle, high = APERTURE
        seen = np.float32(middle) * error
        seen[:, 1:] += np.float32(low) * error[:, :-1]
        seen[:, :-1] += np.float32(high) * error[:, 1:]
        seen *= np.float32(HU_PER_WATER * MM_PER_CM * pi / VIEWS)
        count = 2 * (len(self._filter) - 1)
        spectrum = fft.rfft(seen, count, axis=1, overwrite_x=True)
        spectrum *= self._filter
        return np.ascontiguousarray(fft.irfft(spectrum, count, axis=1, overwrite_x=True)[:, : error.shape[1]])

    def _add_reconstruction(self, image: Values, views: Values, number: int) -> None:
        """Back-project: coarsely everywhere, and finely around the markers in this slice."""
        import cv2

        grid = self._grid
        step = max(1, round(FAR_MM / grid.pixel_mm))
        rows, columns = (-(-size // step) for size in image.shape)
        far_mm = (step * grid.pixel_mm, step * grid.pixel_mm)
        skip = VIEWS // FAR_VIEWS
        groups = views.reshape(FAR_VIEWS, skip, -1).mean(axis=1) * np.float32(skip)
        groups = cv2.blur(groups, (max(1, round(step * grid.pixel_mm / RAY_MM)), 1))
        angles = self._angles.reshape(FAR_VIEWS, skip).mean(axis=1)
        start = np.array([grid.x_mm[0], grid.y_mm[0]]) + 0.5 * (step - 1) * grid.pixel_mm
        coarse = self._back_project(groups, angles, start, far_mm[0], (rows, columns))
        whole = cv2.resize(coarse, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)[
            : image.shape[0], : image.shape[1]
        ]
        for marker, (x_mm, y_mm, z_mm) in enumerate(self._near):
            height_mm = float(grid.z_mm[number]) - z_mm
            if abs(height_mm) > NEAR_MM:
                continue
            part = (
                grid.indices(1, y_mm - NEAR_MM, y_mm + NEAR_MM),
                grid.indices(0, x_mm - NEAR_MM, x_mm + NEAR_MM),
            )
            first = np.array([grid.x_mm[part[1]][0], grid.y_mm[part[0]][0]])
            whole[part] = self._back_project(views, self._angles, first, grid.pixel_mm, whole[part].shape)
            distance2 = (grid.x_mm[part[1]] - x_mm) ** 2 + (grid.y_mm[part[0]] - y_mm)[:, None] ** 2
            reach = 2 * round(METAL_REACH_MM / grid.pixel_mm) + 1
            metal = cv2.dilate(np.uint8(image[part] > DENSE_FROM_HU), np.ones((reach, reach), np.uint8))
            inside = (distance2 + height_mm**2 < INSIDE_MM**2) & (metal == 0)
            self._squares[number, marker] = (whole[part][inside] ** 2).sum(), inside.sum()
        image += whole

    def _back_project(
        self, views: Values, angles: Array, first_mm: Array, step_mm: float, shape: tuple[int, ...]
    ) -> Values:
        """Sum the views (n, rays) over a picture (rows, columns) whose first pixel is at (x, y)."""
        import cv2

        total = np.zeros(shape, dtype=np.float32)
        x0, y0 = first_mm - self._centre_mm
        middle = 0.5 * (len(self._rays_mm) - 1)
        for view, angle in zip(views, angles.tolist(), strict=True):
            c, s = np.cos(angle), np.sin(angle)
            to_ray = np.array(
                [
                    [c * step_mm / RAY_MM, s * step_mm / RAY_MM, (c * x0 + s * y0) / RAY_MM + middle],
                    [0.0, 0.0, 0.0],
                ]
            )
            total += cv2.warpAffine(
                view[None], to_ray, shape[::-1], flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            )
        return total


def _heights(shape: Shape) -> tuple[float, float]:
    (_, _, low), (_, _, high) = shape.bounds()
    return low, high


def _slice_profile(thickness_mm: float) -> tuple[Array, Array]:
    """Return heights around a slice's middle, and their weights: a box with Gaussian flanks."""
    reach_mm = 0.5 * thickness_mm + SLICE_SIGMA_MM
    offsets_mm = np.linspace(-reach_mm, reach_mm, HEIGHTS)
    inside = np.clip((0.5 * thickness_mm - np.abs(offsets_mm)) / SLICE_SIGMA_MM + 0.5, 0.1, 1.0)
    return offsets_mm, inside / inside.sum()


def _ends_within(shape: Rod | Ball, low_mm: float, high_mm: float) -> Sequence[Sequence[float]] | None:
    """Return the ends of a body's axis between two heights, or None if it is outside."""
    if isinstance(shape, Rod):
        return part_between(shape, low_mm, high_mm)
    z = shape.centre[2]
    return (shape.centre, shape.centre) if low_mm - shape.radius < z < high_mm + shape.radius else None


def _chord_ends(
    shape: Rod | Ball, centre_mm: Array, z_mm: float, cosine: Array, sine: Array, rays_mm: Array
) -> tuple[Array, Array]:
    """Return where each ray (n,) enters and leaves a body, in mm along it; equal if it misses."""
    # a ray is t (cos, sin) + s (-sin, cos)
    if isinstance(shape, Ball):
        dx, dy = np.array(shape.centre[:2]) - centre_mm
        square = shape.radius**2 - (shape.centre[2] - z_mm) ** 2
        across = rays_mm - (cosine * dx + sine * dy)
        half = np.sqrt(np.maximum(square - across**2, 0.0))
        middle = cosine * dy - sine * dx
        return middle - half, middle + half
    along = np.array(shape.along)
    start = np.array(shape.start) - (*centre_mm, z_mm)
    dx, dy, dz = rays_mm * cosine - start[0], rays_mm * sine - start[1], -start[2]
    # the height over the rod's start, and the square of the distance from its axis, by powers of s
    by_s = cosine * along[1] - sine * along[0]
    at_0 = dx * along[0] + dy * along[1] + dz * along[2]
    a = np.maximum(1.0 - by_s**2, PARALLEL)
    b = dy * cosine - dx * sine - at_0 * by_s
    c = dx**2 + dy**2 + dz**2 - at_0**2 - shape.radius**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    slope = np.where(np.abs(by_s) < PARALLEL, PARALLEL, by_s)
    one, other = -at_0 / slope, (shape.length - at_0) / slope
    low = np.maximum((-b - root) / a, np.minimum(one, other))
    high = np.minimum((-b + root) / a, np.maximum(one, other))
    return low, np.maximum(low, high)


@lru_cache(maxsize=1)
def _water_table() -> tuple[Array, Array]:
    lengths_cm = np.linspace(0.0, LONGEST_CM, 2401)
    logs = -np.log((SPECTRUM * np.exp(-np.outer(lengths_cm, WATER))).sum(axis=1) / SPECTRUM.sum())
    return logs, lengths_cm


def _as_water_cm(transmitted: Array) -> Array:
    """Return the water, in cm, that transmits this share of the photons."""
    logs, lengths_cm = _water_table()
    return np.asarray(np.interp(-np.log(transmitted / SPECTRUM.sum()), logs, lengths_cm))


def _filter(rays: int, sigma_mm: float, enhanced: float) -> Values:
    """Return a ramp filter with a reconstruction kernel's transfer, in 1/mm, for padded views."""
    from scipy import fft

    count = fft.next_fast_len(2 * rays, real=True)
    count += count % 2
    places = np.minimum(np.arange(count), count - np.arange(count))
    odd = places % 2 == 1
    # the band-limited ramp in space: exact at frequency zero, where a sampled one would be off
    ramp = np.where(odd, -1.0 / (pi * np.where(odd, places, 1) * RAY_MM) ** 2, 0.0)
    ramp[0] = 0.25 / RAY_MM**2
    cycles = fft.rfftfreq(count, RAY_MM)
    sharp, wide = (np.exp(-2.0 * (pi * cycles * size) ** 2) for size in (sigma_mm, 2.0 * sigma_mm))
    aperture = APERTURE[1] + 2.0 * APERTURE[0] * np.cos(2.0 * pi * cycles * RAY_MM)
    # the aperture is part of the stated blur
    transfer = ((1.0 + enhanced) * sharp - enhanced * wide) / np.maximum(aperture, 0.3)
    return np.asarray(fft.rfft(ramp).real * RAY_MM * transfer, dtype=np.float32)


def _photons(noise_HU: float, sigma_mm: float) -> float:
    """Return the photons per ray in air that give this noise behind a head of water."""
    log_variance = (max(noise_HU, LEAST_NOISE_HU) / HU_PER_WATER * _effective_per_mm()) ** 2 / (
        pi**2 / VIEWS * RAY_MM * sqrt(pi) / 2.0 / (4.0 * pi**2 * sigma_mm**2) ** 1.5
    )
    behind = float((SPECTRUM * np.exp(-HEAD_CM * WATER)).sum())
    return float(1.0 / (log_variance * behind))


def _effective_per_mm() -> float:
    """Return the attenuation of water behind a head, in 1/mm."""
    logs, lengths_cm = _water_table()
    step = int(np.searchsorted(lengths_cm, HEAD_CM))
    return float((logs[step + 1] - logs[step]) / (lengths_cm[step + 1] - lengths_cm[step]) / MM_PER_CM)
