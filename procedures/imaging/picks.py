"""Manual fallback: a person picks the spheres roughly, the estimators measure them.

A pick replaces detection, and a marker at a pick may show less of its surface than a detected one, or be
doubtful. It never replaces the measurement: where no sphere shows, the pick is refused with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.imaging.detection import Peak, find_peaks
from procedures.imaging.errors import PickRefused
from procedures.imaging.examination import Sphere, as_marker, examine, with_shape
from procedures.imaging.localization import (
    DIAMETER_MM,
    check_request,
    head_to_foot,
    judged_together,
    require_count,
)
from procedures.imaging.markers import PICKED, Candidate, Localization
from procedures.imaging.pick_files import LPS_FROM_RAS
from procedures.imaging.stack_distortion import distortion_warnings
from procedures.imaging.volume import Volume, VoxelGeometry

Array = NDArray[np.float64]

PICK_TOLERANCE = 1.0  # of the radius: a sphere's centre may be this far from its pick
CROP = 3.2  # of the radius: the neighbourhood that is searched
MIN_SURFACE_SHARE = 0.3
IN_RAS = (
    "It would be on a sphere in RAS, as shown by 3D Slicer: change the signs of the first two numbers, "
    "or give its .mrk.json, which states its coordinate system."
)
IN_METRES = "It would be on a sphere in metres: give millimetres."
START_STEP = 0.4  # of the radius, between starts around a pick without contrast


def localize_picks(
    volume: Volume,
    picks_mm: ArrayLike,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Localization:
    """Localize one sphere of `diameter_mm` at each pick (n, 3) LPS mm; every marker is flagged `picked`.

    Raises CT-019 for a pick without a sphere, outside the volume or on a sphere picked before; CT-016,
    CT-017 and CT-024 as in `localize`.
    """
    picks = np.asarray(picks_mm, dtype=float)
    check_request(volume, diameter_mm, expected)
    if picks.ndim != 2 or picks.shape[1] != 3 or not np.isfinite(picks).all():
        raise PickRefused("picks are rows of three finite numbers", got=f"shape {picks.shape}")
    radius_mm = 0.5 * diameter_mm
    found: list[Sphere] = []
    for number, pick_mm in enumerate(picks, start=1):
        found.append(with_shape(_at_pick(volume, number, pick_mm, radius_mm, found), volume, radius_mm))
        progress(number / len(picks))
    found = [sphere.picked() for sphere in judged_together(found, (), volume.geometry, diameter_mm)]
    candidates = tuple(sphere.candidate for sphere in found)
    require_count(len(found), expected, candidates)
    markers = [as_marker(sphere, found, volume, radius_mm) for sphere in found]
    return Localization(
        markers=tuple(
            sorted((replace(marker, flags=(*marker.flags, PICKED)) for marker in markers), key=head_to_foot)
        ),
        candidates=candidates,
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
        warnings=distortion_warnings(markers, radius_mm),
    )


def _at_pick(volume: Volume, number: int, pick_mm: Array, radius_mm: float, known: list[Sphere]) -> Sphere:
    """The sphere at a pick; refused if there is none, with a hint if there would be one in RAS or metres."""
    try:
        return _measured(volume, number, pick_mm, radius_mm, known)
    except PickRefused as refused:
        if _shows_sphere(volume, number, LPS_FROM_RAS * pick_mm, radius_mm):
            raise _hinted(refused, IN_RAS) from refused
        if _shows_sphere(volume, number, 1e3 * pick_mm, radius_mm):
            raise _hinted(refused, IN_METRES) from refused
        raise


def _hinted(refused: PickRefused, action: str) -> PickRefused:
    return PickRefused(refused.what, expected=refused.expected, action=action)


def _shows_sphere(volume: Volume, number: int, pick_mm: Array, radius_mm: float) -> bool:
    try:
        _measured(volume, number, pick_mm, radius_mm, [])
    except PickRefused:
        return False
    return True


def _measured(volume: Volume, number: int, pick_mm: Array, radius_mm: float, known: list[Sphere]) -> Sphere:
    geometry = volume.geometry
    place = f"pick {number} at ({', '.join(f'{value:g}' for value in pick_mm)}) mm"
    index = geometry.to_index(pick_mm)
    if (index < -0.5).any() or (index > np.array(geometry.shape) - 0.5).any():
        raise PickRefused(f"{place} is outside the scanned volume", expected=_extent(geometry))
    grid_mm = index * geometry.spacing_mm
    refused: list[Candidate] = []
    for peak in _starts(volume, grid_mm, radius_mm):
        outcome = examine(volume, peak, radius_mm, known, min_surface_share=MIN_SURFACE_SHARE)
        if not isinstance(outcome, Sphere):
            refused.append(outcome)
        elif np.linalg.norm(outcome.combined.centre_mm - grid_mm) <= PICK_TOLERANCE * radius_mm:
            return outcome
    reason = "no sphere within reach"
    if refused:
        reason = max(refused, key=lambda one: one.surface_share or 0.0).reason
    raise PickRefused(f"{place} {reason}")


def _extent(geometry: VoxelGeometry) -> str:
    """The scanned range along the patient's axes."""
    corners = np.array(list(product(*((-0.5, size - 0.5) for size in geometry.shape))))
    places_mm = geometry.to_patient_mm(corners)
    ends = zip("LPS", places_mm.min(axis=0), places_mm.max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.0f} to {high:.0f}" for axis, low, high in ends) + " mm"


def _starts(volume: Volume, grid_mm: Array, radius_mm: float) -> list[Peak]:
    """Starting points: peaks of the sphere filter near the pick, then the pick and points around it."""
    part, offset_mm = _crop(volume, grid_mm, CROP * radius_mm)
    peaks = [
        Peak(peak.position_mm + offset_mm, peak.contrast_hu)
        for peak in find_peaks(part, radius_mm)
        if np.linalg.norm(peak.position_mm + offset_mm - grid_mm) <= PICK_TOLERANCE * radius_mm
    ]
    shifts = sorted(product((0.0, -1.0, 1.0), repeat=3), key=lambda shift: sum(map(abs, shift)))
    around = [Peak(grid_mm + START_STEP * radius_mm * np.array(shift), 0.0) for shift in shifts]
    return peaks + around


def _crop(volume: Volume, grid_mm: Array, half_width_mm: float) -> tuple[Volume, Array]:
    geometry = volume.geometry
    shape = np.array(geometry.shape)
    low = np.clip(np.floor((grid_mm - half_width_mm) / geometry.spacing_mm).astype(int), 0, shape - 1)
    high = np.clip(np.ceil((grid_mm + half_width_mm) / geometry.spacing_mm).astype(int) + 1, low + 1, shape)
    z, y, x = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    size = (z.stop - z.start, y.stop - y.start, x.stop - x.start)
    origin_mm = geometry.to_patient_mm(low)
    part = VoxelGeometry(size, origin_mm, geometry.axes, geometry.spacing_mm)
    cropped = replace(volume, voxels=volume.voxels[z, y, x], geometry=part)
    return cropped, low * geometry.spacing_mm
