"""Finds every marker sphere in a volume, with its centre and covariance.

Detection looks over the whole volume; each candidate must then show the surface of a sphere of the right
size. Two estimators that fail differently measure the centre. They are combined, and a marker on which
they differ by more than 0.06 mm is flagged and made less certain rather than believed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from procedures.imaging.detection import find_peaks
from procedures.imaging.errors import LocalizationMisused, MarkerCountWrong
from procedures.imaging.examination import OVERLAPS, Sphere, as_marker, examine
from procedures.imaging.markers import NEAR_ANOTHER, Candidate, Localization, Marker
from procedures.imaging.volume import Volume, VoxelGeometry

Progress = Callable[[float], None]

DIAMETER_MM = 11.5  # the usual passive sphere
DETECTION_SHARE = 0.7  # of the work
MIN_VOXELS_ACROSS = 3.0  # of the diameter, along the coarsest axis


def localize(
    volume: Volume,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Localize all marker spheres of `diameter_mm` in a volume.

    Returns markers in LPS mm from superior to inferior, and every candidate with the reason why it is one
    or not. With `expected`, another count raises CT-016, which carries the candidates; without it, no
    marker at all raises it. `progress` is called with the share done. CT-017 for impossible requests.
    """
    check_request(volume.geometry, diameter_mm, expected)
    report = progress if progress is not None else _silent
    report(0.0)
    radius_mm = 0.5 * diameter_mm
    peaks = find_peaks(volume, radius_mm)
    report(DETECTION_SHARE)
    found: list[Sphere] = []
    candidates: list[Candidate] = []
    for number, peak in enumerate(peaks):
        outcome = examine(volume, peak, radius_mm, found)
        if isinstance(outcome, Sphere):
            found.append(outcome)
            candidates.append(outcome.candidate)
        elif not any(_same_object(outcome, other) for other in candidates):
            candidates.append(outcome)
        report(DETECTION_SHARE + (1.0 - DETECTION_SHARE) * (number + 1) / len(peaks))
    report(1.0)
    require_count(len(found), expected, tuple(candidates))
    overlaps = [one.centre_mm for one in candidates if one.reason == OVERLAPS]
    markers = sorted(
        (_flagged(as_marker(one, found, volume, radius_mm), overlaps, diameter_mm) for one in found),
        key=head_to_foot,
    )
    return Localization(
        markers=tuple(markers),
        candidates=tuple(candidates),
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
    )


def require_count(found: int, expected: int | None, candidates: tuple[Candidate, ...]) -> None:
    """Raise CT-016 for another count than expected, or for none when nothing was said."""
    if expected is None and found == 0:
        raise MarkerCountWrong("no marker found", candidates=candidates)
    if expected is not None and found != expected:
        raise MarkerCountWrong(
            f"{found} marker{'s' if found != 1 else ''} found, {expected} expected", candidates=candidates
        )


def check_request(geometry: VoxelGeometry, diameter_mm: float, expected: int | None) -> None:
    """Raise CT-017 for a diameter or a count that makes no sense in this series."""
    if not np.isfinite(diameter_mm) or diameter_mm < MIN_VOXELS_ACROSS * float(geometry.spacing_mm.max()):
        raise LocalizationMisused(
            f"spheres of {diameter_mm:g} mm cannot be localized",
            limit=f"at least {MIN_VOXELS_ACROSS * float(geometry.spacing_mm.max()):.1f} mm in this series",
        )
    if diameter_mm > float((geometry.spacing_mm * geometry.shape).min()):
        raise LocalizationMisused(f"spheres of {diameter_mm:g} mm do not fit into this series")
    if expected is not None and expected < 0:
        raise LocalizationMisused(f"{expected} is not a possible number of markers")


def _flagged(marker: Marker, overlaps: Sequence[tuple[float, ...]], diameter_mm: float) -> Marker:
    """The marker, flagged when something that was refused overlaps it."""
    close = any(float(np.linalg.norm(marker.centre_mm - other)) < diameter_mm for other in overlaps)
    if not close or NEAR_ANOTHER in marker.flags:
        return marker
    return replace(marker, flags=(*marker.flags, NEAR_ANOTHER))


def _same_object(one: Candidate, other: Candidate) -> bool:
    """Two peaks on one large object lead to the same fitted sphere."""
    if one.radius_mm is None or other.radius_mm is None or other.accepted:
        return False
    return float(np.linalg.norm(np.subtract(one.centre_mm, other.centre_mm))) < 0.5 * one.radius_mm


def head_to_foot(marker: Marker) -> tuple[float, ...]:
    """Sorting key: from superior to inferior."""
    x, y, z = marker.centre_mm.tolist()
    return -z, x, y


def _silent(share: float) -> None:
    """Ignores progress."""
