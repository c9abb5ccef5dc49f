"""The thesis' complete localizer, for comparison with ours on the same data. Not for patients.

It does not estimate its own error: its covariance is the FLE reported in the thesis, equal on all axes.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.localization import DIAMETER_MM, check_request, head_to_foot, require_count
from procedures.imaging.markers import Candidate, Localization, Marker
from procedures.imaging.thesis.circles import AXIAL, SAGITTAL, find_circles, find_regions
from procedures.imaging.thesis.clusters import Cluster, cluster_circles, meeting_clusters
from procedures.imaging.thesis.fits import fit_lines, fit_sphere
from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

RADIUS_TOLERANCE_MM = 1.0
COVARIANCE_ASSUMED = "covariance_assumed"


class ThesisFit(StrEnum):
    """Which of the thesis' two fits determines the centre."""

    LINE = "thesis-line"
    SPHERE = "thesis-sphere"


REPORTED_FLE_MM = {ThesisFit.LINE: 0.1685, ThesisFit.SPHERE: 0.1617}  # thesis, table 2


def localize_as_thesis(
    volume: Volume,
    fit: ThesisFit,
    *,
    diameter_mm: float = DIAMETER_MM,
    expected: int | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Localization:
    """Localize spheres with the thesis' pipeline; arguments and errors as for `localize`."""
    check_request(volume, diameter_mm, expected)
    radius_mm = 0.5 * diameter_mm
    candidates: list[Candidate] = []
    markers: list[Marker] = []
    taken: list[Array] = []
    boxes = find_regions(volume)
    for number, box in enumerate(boxes):
        axial = cluster_circles(find_circles(volume, box, AXIAL), radius_mm)
        sagittal = cluster_circles(find_circles(volume, box, SAGITTAL), radius_mm)
        for pair in meeting_clusters(axial, sagittal):
            centre_mm, marker, reason = _marker(volume, pair, fit, radius_mm)
            if marker is not None and any(np.linalg.norm(centre_mm - one) < diameter_mm for one in taken):
                marker, reason = None, "overlaps a marker that was already found"
            x, y, z = volume.geometry.grid_mm_to_patient_mm(centre_mm).tolist()
            candidates.append(Candidate((x, y, z), marker is not None, reason, 0.0))
            if marker is not None:
                markers.append(marker)
                taken.append(centre_mm)
        progress((number + 1) / len(boxes))
    require_count(len(markers), expected, tuple(candidates))
    return Localization(
        markers=tuple(sorted(markers, key=head_to_foot)),
        candidates=tuple(candidates),
        series_instance_uid=volume.series_instance_uid,
        frame_of_reference_uid=volume.frame_of_reference_uid,
        diameter_mm=diameter_mm,
    )


def _marker(
    volume: Volume, pair: tuple[Cluster, Cluster], fit: ThesisFit, radius_mm: float
) -> tuple[Array, Marker | None, str]:
    by_lines_mm = fit_lines(*pair)
    by_sphere_mm, found_radius_mm, share = fit_sphere(*pair)
    centre_mm = by_lines_mm if fit is ThesisFit.LINE else by_sphere_mm
    if abs(found_radius_mm - radius_mm) > RADIUS_TOLERANCE_MM:
        return centre_mm, None, f"has radius {found_radius_mm:.2f} mm instead of {radius_mm:.2f}"
    marker = Marker(
        centre_mm=volume.geometry.grid_mm_to_patient_mm(centre_mm),
        covariance_mm2=REPORTED_FLE_MM[fit] ** 2 / 3.0 * np.eye(3),
        radius_mm=found_radius_mm,
        quality=share,
        agreement_mm=float(np.linalg.norm(by_lines_mm - by_sphere_mm)),
        flags=(COVARIANCE_ASSUMED,),
    )
    return centre_mm, marker, "is a marker"
