"""Spheres and trajectories of a run as a DICOM RT Structure Set, which most planning stations read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydicom.dataset import Dataset
from pydicom.uid import CTImageStorage, RTStructureSetStorage

from procedures.exchange.allowed_fields import PLANNED
from procedures.exchange.dicom_objects import LONGEST_TEXT, STRUCTURES, Origin, decimals, item, new_object
from procedures.exchange.slicer_markups import YELLOW, Colour, Point
from procedures.exchange.trajectory_lines import COLOURS, DIRECTIONS, ENDS, TrajectoryLine
from procedures.imaging.markers import Marker

DETACHED_STUDY = "1.2.840.10008.3.1.2.3.1"  # retired, but the class by which PS3.3 C.8.8.5 refers to a study
BRIGHTEST = 255  # of a display colour


@dataclass(frozen=True)
class _Structure:
    """Structure of points in the CT, LPS mm."""

    name: str
    description: str
    kind: str  # contour geometric type
    points_mm: Sequence[Point]
    colour: Colour
    is_automatic: bool
    interpreted_as: str = ""


def structure_set(
    spheres: Mapping[str, Marker],
    lines: Sequence[TrajectoryLine],
    origin: Origin,
    slice_uids: Sequence[str] = (),
) -> Dataset:
    """Build the structure set of spheres by name and of lines. The CT's `slice_uids` may be unknown."""
    structures = [
        *(_sphere(name, marker) for name, marker in spheres.items()),
        *(_line(one) for one in lines),
    ]
    made = new_object(origin, RTStructureSetStorage, STRUCTURES, "spheres and trajectories")
    made.OperatorsName = ""
    made.FrameOfReferenceUID, made.PositionReferenceIndicator = origin.frame_of_reference_uid, ""
    made.StructureSetLabel = "RONNA"
    made.StructureSetDate, made.StructureSetTime = made.InstanceCreationDate, made.InstanceCreationTime
    made.ReferencedFrameOfReferenceSequence = [_frame(made.StudyInstanceUID, origin, slice_uids)]
    made.StructureSetROISequence = [
        item(
            ROINumber=number,
            ReferencedFrameOfReferenceUID=origin.frame_of_reference_uid,
            ROIName=one.name[:LONGEST_TEXT],
            ROIDescription=one.description,
            ROIGenerationAlgorithm="AUTOMATIC" if one.is_automatic else "MANUAL",
        )
        for number, one in enumerate(structures, 1)
    ]
    made.ROIContourSequence = [_contour(number, one) for number, one in enumerate(structures, 1)]
    made.RTROIObservationsSequence = [
        item(
            ObservationNumber=number,
            ReferencedROINumber=number,
            RTROIInterpretedType=one.interpreted_as,
            ROIInterpreter="",
        )
        for number, one in enumerate(structures, 1)
    ]
    made.ApprovalStatus = "UNAPPROVED"
    return made


def _sphere(name: str, marker: Marker) -> _Structure:
    description = f"centre of a marker sphere, uncertainty {marker.sigma_mm:.4f} mm rms"
    return _Structure(name, description, "POINT", [marker.centre_mm], YELLOW, True, "MARKER")


def _line(line: TrajectoryLine) -> _Structure:
    description = f"{line.kind} trajectory, entry to {line.end or ENDS[line.kind]}, {DIRECTIONS[line.kind]}"
    points_mm, colour = (line.entry_mm, line.end_mm), COLOURS[line.kind]
    is_automatic = line.kind != PLANNED
    return _Structure(
        f"{line.label} {line.kind}", description, "OPEN_NONPLANAR", points_mm, colour, is_automatic
    )


def _contour(number: int, structure: _Structure) -> Dataset:
    contour = item(
        ContourGeometricType=structure.kind,
        NumberOfContourPoints=len(structure.points_mm),
        ContourData=decimals([value for point_mm in structure.points_mm for value in point_mm]),
    )
    return item(
        ROIDisplayColor=[round(BRIGHTEST * share) for share in structure.colour],
        ContourSequence=[contour],
        ReferencedROINumber=number,
    )


def _frame(study: str, origin: Origin, slice_uids: Sequence[str]) -> Dataset:
    """Build the item of the CT's frame of reference, with the slices it belongs to where they are known."""
    frame = item(FrameOfReferenceUID=origin.frame_of_reference_uid)
    if slice_uids:
        images = [
            item(ReferencedSOPClassUID=CTImageStorage, ReferencedSOPInstanceUID=one) for one in slice_uids
        ]
        series = item(SeriesInstanceUID=origin.series_instance_uid, ContourImageSequence=images)
        frame.RTReferencedStudySequence = [
            item(
                ReferencedSOPClassUID=DETACHED_STUDY,
                ReferencedSOPInstanceUID=study,
                RTReferencedSeriesSequence=[series],
            )
        ]
    return frame
