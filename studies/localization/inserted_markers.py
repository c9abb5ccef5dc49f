"""Markers inserted into a scanned head by projection and filtered back-projection, slice by slice.

The rays through a marker also pass the patient, whose slice is projected for that. The scanner counts what
the spectrum leaves and takes it for water, as scanners do; what it then shows too much against the patient
alone is reconstructed with the blur that the series has, and added to it. The noise is that of the
patient's tissue: in the reconstruction of the marker, the part that the air of the series lacks.

Rays are parallel, and slices as thick as they are apart: a series states neither its fan nor its profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from scipy.special import ndtr

from ronna_hw.arrays import Array
from studies.localization.scanner_of_series import AIR_HU, SeriesScanner

# 120 kV behind the patient, five energies. Mass attenuation in cm2/g at 40, 55, 70, 85 and 105 keV: NIST XCOM
SPECTRUM = np.array([0.16, 0.30, 0.27, 0.16, 0.11])
WATER = np.array([0.2683, 0.2152, 0.1929, 0.1797, 0.1676])
TITANIUM = 4.51 * np.array([2.214, 0.9499, 0.5335, 0.3608, 0.2531])
STEEL = 7.95 * np.array([3.63, 1.506, 0.8090, 0.5090, 0.3340])
POSTS = {"polymer": 1.15 * WATER, "titanium": TITANIUM, "steel": STEEL}

RADIUS_MM, FILM_MM, FILM_DENSITY = 5.75, 0.1, 1.5
INTO_BALL_MM, FLANGE_BELOW_MM, FLANGE_RADIUS_MM, FLANGE_LENGTH_MM = 1.5, 9.5, 3.5, 2.0
HALF_SIDE_MM = 20.0  # of the picture that is replaced around a marker
VIEWS, RAY_MM = 300, 0.3  # over half a turn; rays are finer than any detector, the blur is measured
HEIGHTS, SLICE_BLUR_MM = 9, 0.35  # within a slice's profile; blur of a box as thick as slices are apart
TISSUE_VIEWS = 50
PHOTONS = 1e6  # per ray in air; only for the noise of metal's own shadow
LONGEST_CM = 60.0
MM_PER_CM, HU_PER_WATER = 10.0, 1000.0
TINY = 1e-9


@dataclass(frozen=True)
class InsertedMarker:
    """A ball at `centre_mm` in grid mm (slice, row, column) on a post along the unit vector `down`."""

    centre_mm: Array
    down: Array
    post: str
    post_radius_mm: float
    post_length_mm: float  # from the middle of the ball
    density: float


def insert_markers(
    scanner: SeriesScanner, markers: list[InsertedMarker], random: np.random.Generator
) -> np.ndarray[tuple[int, ...], np.dtype[np.int16]]:
    """Return the voxels (slices, rows, columns) of the series with the markers in it."""
    voxels = scanner.volume.voxels.astype(np.float32)
    for marker in markers:
        reach = HALF_SIDE_MM + marker.post_radius_mm
        low, high = (marker.centre_mm[0] + sign * reach for sign in (-1.0, 1.0))
        first = max(0, int(np.ceil(low / scanner.spacing_mm[0])))
        last = min(len(voxels) - 1, int(np.floor(high / scanner.spacing_mm[0])))
        for number in range(first, last + 1):
            _add_to_slice(voxels, number, scanner, marker, random)
    whole = np.clip(np.rint(voxels), scanner.volume.voxels.min(), np.iinfo(np.int16).max)
    return np.asarray(whole, dtype=np.int16)


def _add_to_slice(
    voxels: np.ndarray[tuple[int, ...], np.dtype[np.float32]],
    number: int,
    scanner: SeriesScanner,
    marker: InsertedMarker,
    random: np.random.Generator,
) -> None:
    spacing = scanner.spacing_mm
    rows, columns = (_indices(marker.centre_mm[axis], spacing[axis], voxels.shape[axis]) for axis in (1, 2))
    half_rays = int(np.sqrt(2.0) * HALF_SIDE_MM / RAY_MM)
    rays_mm: Array = RAY_MM * np.arange(-half_rays, half_rays + 1, dtype=np.float64)
    angles: Array = np.pi * np.arange(VIEWS, dtype=np.float64) / VIEWS
    offsets, weights = _slice_profile(float(spacing[0]))
    heights = number * spacing[0] + offsets - marker.centre_mm[0]
    chords = [_chords_cm(marker, height, angles, rays_mm) for height in heights]
    if not any(ball.any() or post.any() for ball, post in chords):
        return
    patient = np.exp(-np.multiply.outer(_tissue_cm(voxels[number], spacing, marker, angles, rays_mm), WATER))
    behind = SPECTRUM * patient
    through = np.zeros(patient.shape[:2])
    for weight, (ball, post) in zip(weights, chords, strict=True):
        exponents = np.multiply.outer(ball, WATER) + np.multiply.outer(post, POSTS[marker.post])
        through += weight * (behind * np.exp(-exponents)).sum(axis=-1)
    alone = behind.sum(axis=-1)
    own = np.maximum(1.0 / through - 1.0 / alone, 0.0) / PHOTONS  # variance that the marker adds to a ray
    counted = through * np.exp(np.sqrt(own) * random.standard_normal(through.shape))
    added = _reconstruct(
        _as_water_cm(counted) - _as_water_cm(alone), angles, rays_mm, scanner, marker, rows, columns
    )
    quanta = np.asarray(random.standard_normal(through.shape))
    white = _reconstruct(quanta, angles, rays_mm, scanner, marker, rows, columns)
    picture = voxels[number, rows, columns]
    cover = np.clip(added / HU_PER_WATER, 0.0, 1.0)
    missing = np.sqrt(max(scanner.noise_hu**2 - _air_noise_hu(picture) ** 2, 0.0))
    picture += added + cover * missing * white / max(float(white.std()), TINY)


def _slice_profile(thickness_mm: float) -> tuple[Array, Array]:
    """Return heights (n,) within a slice and their weights: a box, blurred."""
    reach = 0.5 * thickness_mm + 2.0 * SLICE_BLUR_MM
    offsets = np.linspace(-reach, reach, HEIGHTS)
    edges = (offsets + 0.5 * thickness_mm) / SLICE_BLUR_MM, (offsets - 0.5 * thickness_mm) / SLICE_BLUR_MM
    weights = ndtr(edges[0]) - ndtr(edges[1])
    return offsets, weights / weights.sum()


def _air_noise_hu(picture: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> float:
    air = picture[picture < AIR_HU + 150.0]
    return float(air.std()) if len(air) else 0.0


def _indices(centre_mm: float, spacing_mm: float, count: int) -> slice:
    low, high = ((centre_mm + sign * HALF_SIDE_MM) / spacing_mm for sign in (-1.0, 1.0))
    return slice(max(0, int(np.ceil(low))), min(count, int(np.floor(high)) + 1))


def _chords_cm(marker: InsertedMarker, height: float, angles: Array, rays_mm: Array) -> tuple[Array, Array]:
    """Return lengths (views, rays) in cm through polymer, as water, and through the post, at a height."""
    ball = _ball_chord(RADIUS_MM, height, rays_mm)
    core = _ball_chord(RADIUS_MM - FILM_MM, height, rays_mm)
    water = np.broadcast_to(FILM_DENSITY * (ball - core) + marker.density * core, (len(angles), len(rays_mm)))
    start = RADIUS_MM - INTO_BALL_MM
    post = _rod_ends(
        marker, start, marker.post_length_mm - start, marker.post_radius_mm, height, angles, rays_mm
    )
    flange = _rod_ends(marker, FLANGE_BELOW_MM, FLANGE_LENGTH_MM, FLANGE_RADIUS_MM, height, angles, rays_mm)
    shared = np.minimum(post[1], flange[1]) - np.maximum(post[0], flange[0])
    solid = (post[1] - post[0]) + (flange[1] - flange[0]) - np.maximum(shared, 0.0)
    half = 0.5 * ball
    in_ball = np.maximum(np.minimum(post[1], half) - np.maximum(post[0], -half), 0.0)
    return (water - marker.density * in_ball) / MM_PER_CM, solid / MM_PER_CM


def _ball_chord(radius_mm: float, height: float, rays_mm: Array) -> Array:
    return np.asarray(2.0 * np.sqrt(np.maximum(radius_mm**2 - height**2 - rays_mm**2, 0.0)))


def _rod_ends(
    marker: InsertedMarker,
    start_mm: float,
    length_mm: float,
    radius_mm: float,
    height: float,
    angles: Array,
    rays_mm: Array,
) -> tuple[Array, Array]:
    """Return where rays (views, rays) enter and leave a rod along the post, in mm along the ray.

    A ray at angle t lies at rays_mm along (row, column) = (sin t, cos t), and runs along (cos t, -sin t).
    """
    z, y, x = marker.down
    sine, cosine = np.sin(angles)[:, None], np.cos(angles)[:, None]
    from_start = np.array([height, 0.0, 0.0]) - start_mm * marker.down
    dy, dx = from_start[1] + rays_mm * sine, from_start[2] + rays_mm * cosine
    slope = cosine * y - sine * x
    lift = from_start[0] * z + dy * y + dx * x
    a = np.maximum(1.0 - slope**2, TINY)
    b = dy * cosine - dx * sine - lift * slope
    c = from_start[0] ** 2 + dy**2 + dx**2 - lift**2 - radius_mm**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    slope = np.where(np.abs(slope) < TINY, TINY, slope)
    one, other = -lift / slope, (length_mm - lift) / slope
    low = np.maximum((-b - root) / a, np.minimum(one, other))
    return low, np.maximum(low, np.minimum((-b + root) / a, np.maximum(one, other)))


def _tissue_cm(
    image: np.ndarray[tuple[int, ...], np.dtype[np.float32]],
    spacing: Array,
    marker: InsertedMarker,
    angles: Array,
    rays_mm: Array,
) -> Array:
    """Return the water (views, rays) in cm of the patient along the rays through a marker's surroundings."""
    water = np.clip(image / HU_PER_WATER + 1.0, 0.0, None)
    middle = marker.centre_mm[1:] / spacing[1:]
    half = float(np.hypot(*(np.array(image.shape) * spacing[1:])))
    along_mm = np.arange(-half, half, 2.0)
    coarse_mm = np.linspace(rays_mm[0], rays_mm[-1], 41)
    sums = np.empty((TISSUE_VIEWS + 1, len(coarse_mm)))
    for view in range(TISSUE_VIEWS):
        turn = np.pi * view / TISSUE_VIEWS
        row = middle[0] + (coarse_mm[:, None] * np.sin(turn) + along_mm * np.cos(turn)) / spacing[1]
        column = middle[1] + (coarse_mm[:, None] * np.cos(turn) - along_mm * np.sin(turn)) / spacing[2]
        seen = cv2.remap(water, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR)
        sums[view] = seen.sum(axis=1) * 2.0 / MM_PER_CM
    sums[-1] = sums[0, ::-1]
    fine = np.array([np.interp(rays_mm, coarse_mm, one) for one in sums])
    place = angles / np.pi * TISSUE_VIEWS
    first = place.astype(int)
    share = (place - first)[:, None]
    return np.asarray((1.0 - share) * fine[first] + share * fine[first + 1])


def _reconstruct(
    views_cm: Array,
    angles: Array,
    rays_mm: Array,
    scanner: SeriesScanner,
    marker: InsertedMarker,
    rows: slice,
    columns: slice,
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return a picture (rows, columns) in HU by filtered back-projection with the blur of the series."""
    spectrum = _filter(len(rays_mm), scanner.blur_mm)
    count = 2 * (len(spectrum) - 1)
    scale = HU_PER_WATER * MM_PER_CM * np.pi / len(angles)
    filtered = np.fft.irfft(np.fft.rfft(views_cm * scale, count, axis=1) * spectrum, count, axis=1)
    filtered = filtered[:, : len(rays_mm)].astype(np.float32)
    spacing = scanner.spacing_mm
    y = (np.arange(rows.start, rows.stop) * spacing[1] - marker.centre_mm[1]).astype(np.float32)[:, None]
    x = (np.arange(columns.start, columns.stop) * spacing[2] - marker.centre_mm[2]).astype(np.float32)
    picture = np.zeros((len(y), len(x)), dtype=np.float32)
    middle = np.float32(0.5 * (len(rays_mm) - 1))
    for view, angle in zip(filtered, angles.tolist(), strict=True):
        place = (y * np.float32(np.sin(angle)) + x * np.float32(np.cos(angle))) / np.float32(RAY_MM) + middle
        picture += cv2.remap(view[None], place, np.zeros_like(place), cv2.INTER_LINEAR)
    return picture


@cache
def _filter(rays: int, blur_mm: float) -> Array:
    """Return the ramp with a Gaussian transfer, in 1/mm, for padded views."""
    count = 1 << int(np.ceil(np.log2(2 * rays)))
    places = np.minimum(np.arange(count), count - np.arange(count))
    odd = places % 2 == 1
    ramp = np.where(odd, -1.0 / (np.pi * np.where(odd, places, 1) * RAY_MM) ** 2, 0.0)
    ramp[0] = 0.25 / RAY_MM**2
    cycles = np.fft.rfftfreq(count, RAY_MM)
    return np.asarray(np.fft.rfft(ramp).real * RAY_MM * np.exp(-2.0 * (np.pi * cycles * blur_mm) ** 2))


@cache
def _water_table() -> tuple[Array, Array]:
    lengths_cm = np.linspace(0.0, LONGEST_CM, 2401)
    return -np.log(np.exp(-np.outer(lengths_cm, WATER)) @ SPECTRUM), lengths_cm


def _as_water_cm(through: Array) -> Array:
    logs, lengths_cm = _water_table()
    return np.interp(-np.log(np.maximum(through, TINY)), logs, lengths_cm)
