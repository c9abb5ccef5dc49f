"""Finds every marker sphere in a volume, with its centre and covariance.

Detection scans the whole volume; each candidate must then show the surface of a sphere of the right size, and
be a whole sphere. Doubtful ones are listed separately, with reasons and odds. Two estimators with different
failure modes measure the centre; a marker on which they differ by more than 0.06 mm is flagged. Where they
are combined, the difference enlarges the covariance; where streaks were fitted together with the sphere, or
its edges alone count, it does not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from procedures.imaging.company import company_doubts, size_doubts
from procedures.imaging.detection import find_peaks
from procedures.imaging.doubts import Doubt
from procedures.imaging.errors import LocalizationMisused, MarkerCountWrong
from procedures.imaging.examination import OVERLAPS, Sphere, as_marker, examine, with_shape
from procedures.imaging.markers import NEAR_ANOTHER, Candidate, Localization, Marker
from procedures.imaging.stack_distortion import distortion_warnings
from procedures.imaging.volume import Volume, VoxelGeometry

Progress = Callable[[float], None]

DIAMETER_MM = 11.5  # the usual passive sphere
DETECTION_SHARE = 0.7  # of the work
CLEAR, UNCLEAR = 0.9, 0.8  # odds that separate an expected number of markers from the rest
NOT_EXPECTED = Doubt("is less marker-like than the expected number of others", 2.0)
MIN_VOXELS_ACROSS = 3.0  # per diameter, along the coarsest axis


def localize(
    volume: Volume,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Progress | None = None,
) -> Localization:
    """Localize all marker spheres of `diameter_mm` in a volume.

    Returns markers in LPS mm from superior to inferior, and every candidate with the reason for accepting or
    rejecting it. With `expected`, the clear ones are taken if exactly that many stand out; any other count
    raises CT-016, which carries the candidates; without it, only a count of zero does. `progress` is called
    with the fraction done. Raises CT-017 for invalid arguments, CT-024 for markers that are all distorted.
    """
    check_request(volume, diameter_mm, expected)
    report = progress if progress is not None else _silent
    report(0.0)
    radius_mm = 0.5 * diameter_mm
    peaks = find_peaks(volume, radius_mm)
    report(DETECTION_SHARE)
    found: list[Sphere] = []
    refused: list[Candidate] = []
    for number, peak in enumerate(peaks):
        outcome = examine(volume, peak, radius_mm, found)
        if isinstance(outcome, Sphere):
            found.append(with_shape(outcome, volume, radius_mm))
        elif not any(_same_object(outcome, other) for other in refused):
            refused.append(outcome)
        report(DETECTION_SHARE + (1.0 - DETECTION_SHARE) * (number + 1) / len(peaks))
    report(1.0)
    judged = judged_together(found, refused, volume.geometry, diameter_mm)
    if expected is not None:
        judged = _clear_ones(judged, expected)
    spheres = [one for one in judged if one.candidate.accepted]
    candidates = (*(one.candidate for one in judged), *refused)
    require_count(len(spheres), expected, candidates)
    overlaps = [one.centre_mm for one in refused if one.reason == OVERLAPS]
    markers = sorted(
        (_flagged(as_marker(one, spheres, volume, radius_mm), overlaps, diameter_mm) for one in spheres),
        key=head_to_foot,
    )
    return Localization(
        markers=tuple(markers),
        candidates=candidates,
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
        warnings=distortion_warnings(markers, radius_mm),
    )


def judged_together(
    found: Sequence[Sphere], refused: Sequence[Candidate], geometry: VoxelGeometry, diameter_mm: float
) -> list[Sphere]:
    """The spheres with the doubts that the others raise about each."""
    if not found:
        return []
    centres_mm = np.array([one.combined.centre_mm for one in found])
    overlapping = [one.centre_mm for one in refused if one.reason == OVERLAPS]
    others_mm = geometry.to_index(np.array(overlapping).reshape(-1, 3)) * geometry.spacing_mm
    beside = company_doubts(centres_mm, others_mm, diameter_mm)
    judged = [sphere.doubted(doubts) for sphere, doubts in zip(found, beside, strict=True)]
    sizes = size_doubts(
        np.array([one.combined.radius_mm for one in judged]),
        np.array([one.candidate.accepted for one in judged]),
    )
    return [sphere.doubted((doubt,)) for sphere, doubt in zip(judged, sizes, strict=True)]


def _clear_ones(judged: Sequence[Sphere], expected: int) -> list[Sphere]:
    """If more markers than expected: the clear ones if exactly that many stand out; else all, unchanged."""
    accepted = sorted((one for one in judged if one.candidate.accepted), key=lambda one: -one.candidate.odds)
    if not 0 < expected < len(accepted):
        return list(judged)
    last, next_ = accepted[expected - 1].candidate.odds, accepted[expected].candidate.odds
    if last < CLEAR or next_ > UNCLEAR:
        return list(judged)
    unclear = {id(one) for one in accepted[expected:]}
    return [one.doubted((NOT_EXPECTED,)) if id(one) in unclear else one for one in judged]


def require_count(found: int, expected: int | None, candidates: tuple[Candidate, ...]) -> None:
    """Raise CT-016 if the count is not as expected, or is zero with no expectation given."""
    if expected is None and found == 0:
        raise MarkerCountWrong("no marker found", candidates=candidates)
    if expected is not None and found != expected:
        raise MarkerCountWrong(
            f"{found} marker{'s' if found != 1 else ''} found, {expected} expected", candidates=candidates
        )


def check_request(volume: object, diameter_mm: float, expected: int | None) -> None:
    """Raise CT-017 unless volume, diameter and count make sense together."""
    if not isinstance(volume, Volume):
        raise LocalizationMisused(
            "spheres are localized in a Volume, which carries its geometry in mm",
            got=type(volume).__name__,
            action="Read one with procedures.imaging.read_series(FOLDER).",
        )
    geometry = volume.geometry
    coarsest_mm = float(geometry.spacing_mm.max())
    if not np.isfinite(diameter_mm) or diameter_mm < MIN_VOXELS_ACROSS * coarsest_mm:
        finer_mm = diameter_mm / MIN_VOXELS_ACROSS
        raise LocalizationMisused(
            f"spheres of {diameter_mm:g} mm cannot be localized in voxels of {coarsest_mm:g} mm",
            limit=f"at least {MIN_VOXELS_ACROSS * coarsest_mm:.1f} mm",
            action=f"Reconstruct with slices and pixels of at most {finer_mm:.1f} mm, or check the diameter.",
        )
    if diameter_mm > float((geometry.spacing_mm * geometry.shape).min()):
        raise LocalizationMisused(f"spheres of {diameter_mm:g} mm do not fit into this series")
    if expected is not None and expected < 0:
        raise LocalizationMisused(f"{expected} is not a possible number of markers")


def _flagged(marker: Marker, overlaps: Sequence[tuple[float, ...]], diameter_mm: float) -> Marker:
    """The marker, flagged if something rejected overlaps it."""
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
