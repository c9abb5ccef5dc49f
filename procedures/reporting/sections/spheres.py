"""Spheres: in the CT, by the tracker, and by the stereo head."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from procedures.imaging.markers import Marker
from procedures.reporting.files import Picture, load_pictures
from procedures.reporting.outcome import CtOutcome, Truth
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres, LocalizedFiducials
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import Relocalization
from ronna_hw.calibration import Numbers3


class SphereRow(NamedTuple):
    """Sphere of the CT, and where the tracker measured it, in the tracker frame."""

    number: int  # counts from 1
    marker: Marker
    tracker_mm: Numbers3 | None  # none where nothing is paired with it


class StereoRow(NamedTuple):
    """Sphere measured with the stereo head."""

    trajectory: str  # empty if measured for all
    number: int  # counts from 1
    looks: int
    residuals_mm: tuple[float, ...]  # image pair by image pair
    ray_gap_mm: float


@dataclass(frozen=True)
class Spheres:
    """Spheres as each instrument measured them, with pictures."""

    localization: LocalizedFiducials | None  # those that count
    scan: IntraoperativeSpheres | None  # the same, if the clamped head was scanned
    series: ImportedCt | None
    truth: CtOutcome | None
    rows: tuple[SphereRow, ...]
    tracked: bool  # the tracker has measured them
    unpaired_mm: tuple[Numbers3, ...]  # measured by the tracker, tracker frame
    ct_pictures: tuple[Picture, ...]
    scan_pictures: tuple[Picture, ...]
    stereo: tuple[StereoRow, ...]
    stereo_pictures: tuple[Picture, ...]


def read_spheres(reading: RunReading, truth: Truth | None) -> Spheres:
    """Read the section."""
    localization, tracked = reading.find(LocalizedFiducials), reading.find(GlobalLocalization)
    matched = reading.find(Correspondence)
    points_mm = () if tracked is None else tracked.points_tracker_mm
    partners = {} if matched is None else dict(matched.pairs)
    paired_mm = {index: points_mm[place] for index, place in partners.items() if 0 <= place < len(points_mm)}
    return Spheres(
        localization=localization,
        scan=localization if isinstance(localization, IntraoperativeSpheres) else None,
        series=reading.find(ImportedCt),
        truth=None if truth is None else truth.ct,
        rows=tuple(
            SphereRow(number, marker, paired_mm.get(number - 1))
            for number, marker in ({} if localization is None else localization.numbered).items()
        ),
        tracked=tracked is not None,
        unpaired_mm=tuple(point for place, point in enumerate(points_mm) if place not in partners.values()),
        ct_pictures=load_pictures(reading, "ct-"),
        scan_pictures=load_pictures(reading, "scan-"),
        stereo=tuple(_stereo_rows(reading)),
        stereo_pictures=load_pictures(reading, "stereo-"),
    )


def _stereo_rows(reading: RunReading) -> Iterator[StereoRow]:
    for stored in reading.valid_results(Relocalization):
        fine = stored.result
        axes = fine.axes or (stored.record.trajectory or "",) * len(fine.fiducials)
        columns = axes, fine.fiducials, fine.looks, fine.residuals_mm, fine.ray_gaps_mm
        for axis, fiducial, looks, residuals_mm, ray_gap_mm in zip(*columns, strict=True):
            yield StereoRow(axis, fiducial + 1, looks, residuals_mm, ray_gap_mm)
