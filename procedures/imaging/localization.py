"""Localization of all marker spheres in a volume, with centres and covariances.

A matched filter on a coarse grid detects candidates: the volume is resampled to about a millimetre, clipped
so that bone and metal do not outshine a polymer sphere, and correlated with a kernel that compares the mean
inside a ball with that of a surrounding shell. The response is a contrast in HU.

Each candidate must then show the surface of a sphere of the right size, and be a whole sphere; doubtful ones
are listed apart, with reasons and odds. Two estimators with different failure modes measure the centre. A
marker on which they differ by more than 0.06 mm is flagged. Where they are combined, the difference enlarges
the covariance; where streaks were fitted together with the sphere, or its edges alone count, it does not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from procedures.imaging.doubts import assess_neighbours, assess_sizes
from procedures.imaging.errors import LOCALIZATION_MISUSED, MarkerCountWrong
from procedures.imaging.examination import (
    OVERLAPS,
    Sphere,
    as_candidate,
    as_marker,
    examine_place,
    judge_shape,
)
from procedures.imaging.markers import Candidate, Localization, Marker, MarkerDoubt
from procedures.imaging.scan_deformation import combine_spheres
from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arguments import require_numbers, show
from ronna_hw.arrays import Array
from ronna_hw.text import format_count

VOXELS_PER_RADIUS = 5.75  # a 1 mm grid for the usual 11.5 mm sphere
CLIP_HU = (-1000.0, 300.0)  # air to dense polymer
BALL_TO = 0.90  # of the radius: safely inside despite blur
SHELL_FROM, SHELL_TO = 1.15, 1.53  # of the radius
MIN_CONTRAST_HU = 450.0  # a polymer sphere in air shows about 1000, one touching skin half of that
SEPARATION = 1.2  # of the radius: weaker peaks closer to a stronger one are the same object
MAX_PEAKS = 200

Progress = Callable[[float], None]

DIAMETER_MM = 11.5  # the usual passive sphere
LEAST_DIAMETER_MM = 1.0  # no marker is smaller, and none as large as 1 m: below it a diameter is in metres
DETECTION_SHARE = 0.7  # of the work
CLEAR, UNCLEAR = 0.9, 0.8  # odds that separate an expected number of markers from the rest
NOT_EXPECTED = MarkerDoubt("is less marker-like than the expected number of others", 2.0)
MIN_VOXELS_ACROSS = 3.0  # per diameter, along the coarsest axis


def localize(
    volume: Volume,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Progress = lambda share: None,
) -> Localization:
    """Localize all marker spheres of `diameter_mm` in a volume.

    Returns markers in LPS mm from superior to inferior, and every candidate with the reason for accepting or
    rejecting it. With `expected`, the clear ones are taken if exactly that many stand out; any other count
    raises CT-016, which carries the candidates; without it, only a count of zero does. `progress` is called
    with the fraction done. Raises CT-017 for invalid arguments. A deformed scan is not refused here.
    """
    check_request(volume, diameter_mm, expected)
    progress(0.0)
    radius_mm = 0.5 * diameter_mm
    peaks = find_peaks(volume, radius_mm)
    progress(DETECTION_SHARE)
    found: list[Sphere] = []
    refused: list[Candidate] = []
    for number, (place_mm, contrast_hu) in enumerate(peaks):
        outcome = examine_place(volume, place_mm, contrast_hu, radius_mm, found)
        if isinstance(outcome, Sphere):
            found.append(judge_shape(outcome, volume, radius_mm))
        elif not any(_is_same_object(outcome, other) for other in refused):
            refused.append(outcome)
        progress(DETECTION_SHARE + (1.0 - DETECTION_SHARE) * (number + 1) / len(peaks))
    progress(1.0)
    judged = judge_spheres(found, refused, volume.geometry, diameter_mm)
    if expected is not None:
        judged = _keep_clear(judged, expected)
    spheres = sorted(
        (one for one in judged if one.accepted),
        key=lambda one: superior_first_key(volume.patient_mm(one.centre_mm)),
    )
    candidates = (*(as_candidate(one, volume) for one in judged), *refused)
    require_count(len(spheres), expected, candidates, diameter_mm)
    overlaps = [one for one in refused if one.reason == OVERLAPS]
    markers = [as_marker(one, spheres, volume, radius_mm, overlaps) for one in spheres]
    return combine_markers(volume, diameter_mm, spheres, markers, candidates)


def combine_markers(
    volume: Volume,
    diameter_mm: float,
    spheres: Sequence[Sphere],
    markers: Iterable[Marker],
    candidates: tuple[Candidate, ...],
) -> Localization:
    """Return the localization of these markers, with what their spheres together show of the scan."""
    return Localization(
        markers=tuple(markers),
        candidates=candidates,
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
        deformation=combine_spheres([one.deformation for one in spheres], 0.5 * diameter_mm, volume.geometry),
    )


def find_peaks(volume: Volume, radius_mm: float) -> list[tuple[Array, float]]:
    """Find the maxima of the sphere filter, strongest first: grid positions (3,) mm, contrasts in HU."""
    response, step_mm = _filter_spheres(volume, radius_mm)
    places = np.argwhere(response > MIN_CONTRAST_HU)
    strengths = response[tuple(places.T)]
    order = np.argsort(-strengths, kind="stable")
    places_mm = places[order] * step_mm
    strengths = strengths[order]
    peaks: list[tuple[Array, float]] = []
    free = np.ones(len(places_mm), dtype=bool)
    while free.any() and len(peaks) < MAX_PEAKS:
        best = int(np.argmax(free))
        # offset between voxel centres of the coarse grid and of the volume
        offset_mm = 0.5 * (step_mm - volume.geometry.spacing_mm)
        peaks.append((places_mm[best] + offset_mm, float(strengths[best])))
        free &= np.linalg.norm(places_mm - places_mm[best], axis=1) > SEPARATION * radius_mm
    return peaks


def _filter_spheres(volume: Volume, radius_mm: float) -> tuple[NDArray[np.float32], Array]:
    """Return the sphere filter's response on a coarse grid, and the grid's spacing (3,) mm."""
    coarse, step_mm = _resample(volume, radius_mm / VOXELS_PER_RADIUS)
    kernel = _build_kernel(radius_mm, step_mm)
    # outside the volume counts as air; the kernel is symmetric, so convolution equals correlation
    middle = [k // 2 for k in kernel.shape]
    inner = tuple(slice(k, k + n) for k, n in zip(middle, coarse.shape, strict=True))
    shape = [fft.next_fast_len(n + k, real=True) for n, k in zip(coarse.shape, middle, strict=True)]
    spectrum = fft.rfftn(coarse, s=shape)
    del coarse  # each of these arrays has tens of megabytes
    np.multiply(_transform_kernel(kernel, shape), spectrum, out=spectrum)
    return fft.irfftn(spectrum, s=shape, overwrite_x=True)[inner], step_mm


def _resample(volume: Volume, step_mm: float) -> tuple[NDArray[np.float32], Array]:
    """Resample HU above air to a coarse grid of about `step_mm`; also return the exact spacing (3,) mm."""
    slices, rows, columns = volume.geometry.shape
    counts = np.maximum(np.rint(volume.extent_mm / step_mm).astype(int), 1)
    planes = np.empty((slices, counts[1], counts[2]), dtype=np.float32)
    is_smaller = counts[1] <= rows and counts[2] <= columns
    for number, plane in enumerate(volume.voxels):
        clipped = np.clip(plane, int(CLIP_HU[0]), int(CLIP_HU[1])).astype(np.float32)
        cv2.resize(
            clipped,
            (int(counts[2]), int(counts[1])),
            dst=planes[number],
            interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR,
        )
    planes -= CLIP_HU[0]
    if counts[0] != slices:
        resize = _average_slices if counts[0] < slices else _interpolate_slices
        planes = resize(planes.reshape(slices, -1), counts[0]).reshape(counts)
    return planes, volume.extent_mm / counts


def _interpolate_slices(flat: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    place = np.clip((np.arange(count) + 0.5) * len(flat) / count - 0.5, 0, len(flat) - 1)
    below = np.minimum(place.astype(int), max(len(flat) - 2, 0))
    share = (place - below).astype(np.float32)[:, None]
    above = np.minimum(below + 1, len(flat) - 1)
    return np.asarray(flat[below] * (1 - share) + flat[above] * share)


def _average_slices(flat: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    edges = np.arange(count + 1) * len(flat) / count
    result = np.empty((count, flat.shape[1]), dtype=np.float32)
    for number, (low, high) in enumerate(pairwise(edges.tolist())):
        cells = np.arange(int(low), min(int(np.ceil(high)), len(flat)))
        cover = np.minimum(cells + 1, high) - np.maximum(cells, low)
        np.dot((cover / cover.sum()).astype(np.float32), flat[cells[0] : cells[-1] + 1], out=result[number])
    return result


def _build_kernel(radius_mm: float, step_mm: Array) -> NDArray[np.float32]:
    half_sides = np.ceil(SHELL_TO * radius_mm / step_mm).astype(int)
    grid = np.meshgrid(
        *(np.arange(-r, r + 1) * step for r, step in zip(half_sides, step_mm, strict=True)), indexing="ij"
    )
    distance = np.linalg.norm(grid, axis=0) / radius_mm
    ball = distance < BALL_TO
    shell = (distance > SHELL_FROM) & (distance < SHELL_TO)
    return np.asarray(ball / ball.sum() - shell / shell.sum(), dtype=np.float32)


def _transform_kernel(kernel: NDArray[np.float32], shape: list[int]) -> NDArray[np.complex64]:
    # axis by axis: lines on which the small kernel is still zero are not transformed
    spectrum = fft.rfft(kernel, n=shape[2], axis=2)
    for axis in (1, 0):
        spectrum = fft.fft(spectrum, n=shape[axis], axis=axis, overwrite_x=True)
    return np.asarray(spectrum)


def judge_spheres(
    found: Sequence[Sphere], refused: Sequence[Candidate], geometry: VoxelGeometry, diameter_mm: float
) -> list[Sphere]:
    """Add the doubts that spheres and rejected candidates raise about each other."""
    if not found:
        return []
    centres_mm = np.array([one.centre_mm for one in found])
    overlapping = [one.centre_mm for one in refused if one.reason == OVERLAPS]
    others_mm = geometry.to_index(np.array(overlapping).reshape(-1, 3)) * geometry.spacing_mm
    by_neighbours = assess_neighbours(centres_mm, others_mm, diameter_mm)
    judged = [one.with_doubts(doubts) for one, doubts in zip(found, by_neighbours, strict=True)]
    radii_mm = np.array([one.radius_mm for one in judged])
    by_size = assess_sizes(radii_mm, np.array([one.accepted for one in judged]))
    return [one.with_doubts((doubt,)) for one, doubt in zip(judged, by_size, strict=True)]


def _keep_clear(judged: Sequence[Sphere], expected: int) -> list[Sphere]:
    """If exactly the expected number of markers stands out, add a doubt to the other accepted spheres."""
    accepted = sorted((one for one in judged if one.accepted), key=lambda one: -one.odds)
    if not 0 < expected < len(accepted):
        return list(judged)
    last_odds, next_odds = accepted[expected - 1].odds, accepted[expected].odds
    if last_odds < CLEAR or next_odds > UNCLEAR:
        return list(judged)
    unclear = {id(one) for one in accepted[expected:]}
    return [one.with_doubts((NOT_EXPECTED,)) if id(one) in unclear else one for one in judged]


def require_count(
    found: int, expected: int | None, candidates: tuple[Candidate, ...], diameter_mm: float
) -> None:
    """Raise CT-016 for a count other than expected or, without an expected count, for zero."""
    if expected is None and found == 0:
        raise MarkerCountWrong(
            f"no marker found; expected spheres of {diameter_mm:g} mm", candidates=candidates
        )
    if expected is not None and found != expected:
        raise MarkerCountWrong(
            f"{format_count(found, 'marker')} found, {expected} expected", candidates=candidates
        )


def check_request(volume: object, diameter_mm: float, expected: int | None) -> None:
    """Raise CT-017 unless volume, diameter and expected count are valid together."""
    if not isinstance(volume, Volume):
        raise LOCALIZATION_MISUSED(
            "spheres are localized in a Volume, which carries its geometry in mm",
            got=type(volume).__name__,
            action="Read one with procedures.imaging.read_series(FOLDER).",
        )
    geometry = volume.geometry
    coarsest_mm = float(geometry.spacing_mm.max())
    (size_mm,) = require_numbers([diameter_mm], "diameter_mm", shape=(1,), mistake=LOCALIZATION_MISUSED)
    if not 0.0 < size_mm < np.inf:
        raise LOCALIZATION_MISUSED(
            "diameter_mm is not the diameter of a sphere",
            expected="a positive number",
            got=show(diameter_mm),
            action="Give the diameter of the spheres in mm.",
        )
    if size_mm < LEAST_DIAMETER_MM:
        raise LOCALIZATION_MISUSED(
            "diameter_mm is no size of a marker",
            limit=f"at least {LEAST_DIAMETER_MM:g} mm",
            got=f"{size_mm:g} mm",
            action="Are these metres? Give millimetres.",
        )
    if diameter_mm < MIN_VOXELS_ACROSS * coarsest_mm:
        finer_mm = diameter_mm / MIN_VOXELS_ACROSS
        raise LOCALIZATION_MISUSED(
            f"spheres of {diameter_mm:g} mm cannot be localized in voxels of {coarsest_mm:g} mm",
            limit=f"at least {MIN_VOXELS_ACROSS * coarsest_mm:.1f} mm",
            action=f"Reconstruct with slices and pixels of at most {finer_mm:.1f} mm, or check the diameter.",
        )
    if diameter_mm > float((geometry.spacing_mm * geometry.shape).min()):
        raise LOCALIZATION_MISUSED(f"spheres of {diameter_mm:g} mm do not fit into this series")
    if expected is not None and not (isinstance(expected, int | np.integer) and expected >= 0):
        raise LOCALIZATION_MISUSED(f"{show(expected)} is not a possible number of markers")


def _is_same_object(one: Candidate, other: Candidate) -> bool:
    """Whether two peaks within one large object led to the same fitted sphere."""
    if one.radius_mm is None or other.radius_mm is None or other.accepted:
        return False
    return float(np.linalg.norm(np.subtract(one.centre_mm, other.centre_mm))) < 0.5 * one.radius_mm


def superior_first_key(centre_mm: Sequence[float]) -> tuple[float, ...]:
    """Return a sort key that orders LPS positions from superior to inferior."""
    x, y, z = centre_mm
    return -z, x, y
