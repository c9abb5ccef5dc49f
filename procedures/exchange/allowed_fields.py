"""Allow-list of the only fields that `export` may write outside a run folder.

No field holds a person's name, number, date of birth, place or device. Study, series and frame of reference
are named by their DICOM UIDs: without them no other program could overlay the result on the CT. Patient and
study are added to DICOM objects afterwards and only on request, from the CT itself: see `ct_study`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from pydicom.dataset import Dataset

from procedures.exchange.errors import FIELD_NOT_ALLOWED

M = TypeVar("M")

# Trajectory names are free text in the plan and may contain a patient's name: only plain labels such as T1 or
# L12 are exported; any other trajectory is identified by its number.
PLAIN_LABEL = re.compile(r"[A-Za-z]{1,3}\d{1,3}")

SPHERE_FIELDS = {
    "centre_mm": "centre in LPS, as it counts: by the CT, or by a scan of the clamped head",
    "covariance_mm2": "of the centre",
    "radius_mm": "as measured",
    "quality": "0 to 1",
    "agreement_mm": "between the two estimates of the centre",
    "flags": "fixed words of the localizer",
    "odds": "that it is a marker, 0 to 1",
    "planning_ct_mm": "centre in the planning CT; null if it is new since",
}
REGISTRATION_FIELDS = {
    "trajectory": "its label, or its number",
    "robot_from_ct": "pose robot <- CT of the head as registered, the same for all its targets",
    "correction_mm": "x y z, robot frame: from the target's place by that pose to where the arm is sent, for "
    "errors learned of it; zero without",
    "pairs": "spheres used in the fit",
    "fre_mm": "of the fit; not a measure of accuracy",
    "predicted_tre_mm": "predicted error at the target, rms",
    "predicted_tre_limit_mm": "radius at the confidence",
    "confidence": "of that radius",
    "record": "SHA-256 of the record",
}
DOCUMENT_FIELDS = {
    "series_instance_uid": "the CT series",
    "frame_of_reference_uid": "its coordinate system",
    "study_instance_uid": "its study; empty if the CT or the record does not state it",
    "coordinate_system": "LPS",
    "direction": "frame of the points, or the mapping from which they come: `ct <- robot`",
    "unit": "mm",
    "spheres": "one entry for each sphere",
    "registrations": "one entry for each target",
    "name": "of a sphere: M1, M2, ...",
}
INDEX_FIELDS = {
    "ending": "how the run ended: done, missed, in doubt, error not determined, failed, ...",
    "code": "of the error that ended it",
    "simulated": "whether the theatre was simulated",
    "identified": "whether the DICOM objects name patient and study of the CT",
    "files": "what each file holds",
    "sha256": "hash of each file as it was exported",
    "absent": "what the run does not have, and why",
    "withheld": "what the run has and the export leaves out, and why",
}


@dataclass(frozen=True)
class Column:
    """Column of an exported table, as Slicer's schema of the table and the reference page describe it."""

    name: str
    meaning: str
    kind: Literal["double", "int", "string"] = "double"
    unit: str = ""


def _in_mm(names: str, meaning: str) -> tuple[Column, ...]:
    return tuple(Column(name, meaning, unit="mm") for name in names.split())


_ORIGIN_COLUMNS = tuple(
    Column(name, DOCUMENT_FIELDS[name], "string")
    for name in (
        *("coordinate_system", "direction", "unit"),
        *("series_instance_uid", "frame_of_reference_uid", "study_instance_uid"),
    )
)
_TRAJECTORY = Column("trajectory", REGISTRATION_FIELDS["trajectory"], "string")
_PREDICTED = (
    *_in_mm("predicted_tre_mm", REGISTRATION_FIELDS["predicted_tre_mm"]),
    *_in_mm("predicted_tre_limit_mm", REGISTRATION_FIELDS["predicted_tre_limit_mm"]),
    Column("confidence", REGISTRATION_FIELDS["confidence"]),
)
PLANNED, REACHED, FOUND = "planned", "reached", "found"
LPS_COLUMNS = ("L_mm", "P_mm", "S_mm")
PLANNING_CT_COLUMNS = ("planning_ct_L_mm", "planning_ct_P_mm", "planning_ct_S_mm")
CORRECTION = ("correction_x_mm", "correction_y_mm", "correction_z_mm")
TABLES: dict[str, tuple[Column, ...]] = {
    "spheres.csv": (
        Column("name", DOCUMENT_FIELDS["name"], "string"),
        *_in_mm(" ".join(LPS_COLUMNS), "centre, as it counts: by the CT, or by a scan of the clamped head"),
        *_in_mm("uncertainty_mm", "of the centre, 3-D rms"),
        *_in_mm(" ".join(PLANNING_CT_COLUMNS), "centre in the planning CT; empty if it is new since"),
        *_ORIGIN_COLUMNS,
    ),
    "lines.csv": (
        _TRAJECTORY,
        Column("line", f"{PLANNED}, {REACHED} or {FOUND}", "string"),
        *_in_mm(
            "entry_L_mm entry_P_mm entry_S_mm", "entry; of other lines, the point nearest to the planned one"
        ),
        *_in_mm("end_L_mm end_P_mm end_S_mm", "planned target; of other lines, the tip"),
        *_in_mm("length_mm", "from entry to end"),
        *_ORIGIN_COLUMNS,
    ),
    "errors.csv": (
        _TRAJECTORY,
        Column("state", "reached, not reached or left out", "string"),
        Column("in_doubt", "1 if the error may exceed the prediction: the report says why", "int"),
        *_in_mm("depth_mm", "planned, from entry to target"),
        *_in_mm("margin_mm", "largest error at the target that the plan accepts"),
        Column(
            "strategy", "of localization, used for this target; empty if its paths were not checked", "string"
        ),
        *_PREDICTED,
        *_in_mm(
            "nominal_error_mm nominal_lateral_mm nominal_axial_mm",
            "tip by joints and depth stop, minus target: without the errors of arm and registration",
        ),
        *_in_mm("stereo_error_mm", "measured by the stereo head in place of the guide, on a phantom"),
        *_in_mm(
            "found_error_mm found_lateral_mm found_axial_mm",
            "tip in the CT after the operation, minus target",
        ),
        *_in_mm(
            "simulated_error_mm simulated_lateral_mm simulated_axial_mm",
            "true tip minus target, from the simulated theatre; never in a real one",
        ),
        *_ORIGIN_COLUMNS,
    ),
    "registrations.csv": (
        _TRAJECTORY,
        *(
            Column(
                f"m{row}{column}",
                "pose robot <- CT of the head as registered, row by row",
                unit="mm" if column == 4 else "",
            )
            for row in range(1, 4)
            for column in range(1, 5)
        ),
        *_in_mm(" ".join(CORRECTION), REGISTRATION_FIELDS["correction_mm"]),
        Column("pairs", REGISTRATION_FIELDS["pairs"], "int"),
        *_in_mm("fre_mm", REGISTRATION_FIELDS["fre_mm"]),
        *_PREDICTED,
        *_ORIGIN_COLUMNS,
    ),
}
FILES = {
    "export.json": "index: frame, unit, UIDs, the files and what is absent",
    "planned.mrk.json": "planned trajectories as lines, entry to target, in the CT",
    "reached.mrk.json": "reached trajectories as lines, entry to tip by joints and depth stop, ct <- robot",
    "found.mrk.json": "trajectories found in the CT after the operation as lines, in the planning CT",
    "spheres.mrk.json": "centres of the spheres as points, in the CT",
    "lines.csv": "all lines",
    "errors.csv": "errors at each target; axial ones along the planned line, positive is too deep",
    "spheres.csv": "centres of the spheres",
    "registrations.csv": "registration used at each target, robot <- ct, and the correction learned there",
    "*.schema.csv": "types, units and meanings of the columns of the table of that name, read by Slicer",
    "spheres.json": "spheres with covariances",
    "registrations.json": "registrations",
    "spheres.dcm": "DICOM Spatial Fiducials",
    "registration-*.dcm": "DICOM Spatial Registration, one for each registration: robot <- ct of the head as "
    "registered",
    "structures.dcm": "DICOM RT Structure Set: spheres as points, trajectories as lines of two points",
    "report-page.dcm": "DICOM Secondary Capture: how the run ended, and the errors at its targets",
    "scan.ply": "points of the scanned skin, ct <- robot, with covariances, looks and lines; "
    "only with --with-scan",
    "scan.vtp": "the same as VTK's poly data; only with --with-scan",
    "postoperative-report.dcm": "DICOM structured report: errors in the CT after the operation, with units",
}

# DICOM attributes, by the standard's keywords; those that must be present but empty come first.
IDENTITY = (
    *("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime"),
    *("AccessionNumber", "ReferringPhysicianName", "StudyID"),
)
EMPTY_ATTRIBUTES = (
    *IDENTITY,
    *("ContentCreatorName", "PositionReferenceIndicator", "OperatorsName", "ROIInterpreter"),
    *("PatientOrientation", "PerformedProcedureCodeSequence", "ReferencedPerformedProcedureStepSequence"),
)
FILLED_ATTRIBUTES = (
    *("SpecificCharacterSet", "SOPClassUID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID"),
    *(
        "SeriesDescription",
        "BodyPartExamined",
        "InstanceCreationDate",
        "InstanceCreationTime",
        "SeriesNumber",
        "InstanceNumber",
        "Modality",
        "Manufacturer",
    ),
    *("ManufacturerModelName", "DeviceSerialNumber", "SoftwareVersions", "ContentDate", "ContentTime"),
    *("ContentLabel", "ContentDescription", "FrameOfReferenceUID", "FiducialSetSequence"),
    *("FiducialSequence", "FiducialIdentifier", "FiducialDescription", "FiducialUID", "ShapeType"),
    *("NumberOfContourPoints", "ContourData", "ContourUncertaintyRadius", "RegistrationSequence"),
    *("MatrixRegistrationSequence", "FrameOfReferenceTransformationComment"),
    *("RegistrationTypeCodeSequence", "CodeValue", "CodingSchemeDesignator", "CodeMeaning"),
    *("MatrixSequence", "FrameOfReferenceTransformationMatrixType"),
    *("FrameOfReferenceTransformationMatrix", "UsedFiducialsSequence", "ReferencedSOPClassUID"),
    "ReferencedSOPInstanceUID",
    # RT Structure Set
    *("StructureSetLabel", "StructureSetDate", "StructureSetTime", "ReferencedFrameOfReferenceSequence"),
    *("RTReferencedStudySequence", "RTReferencedSeriesSequence", "ContourImageSequence"),
    *("StructureSetROISequence", "ROINumber", "ReferencedFrameOfReferenceUID", "ROIName", "ROIDescription"),
    *("ROIGenerationAlgorithm", "ROIContourSequence", "ROIDisplayColor", "ContourSequence"),
    *("ContourGeometricType", "ReferencedROINumber", "RTROIObservationsSequence", "ObservationNumber"),
    *("RTROIInterpretedType", "ApprovalStatus"),
    # Secondary Capture
    *("ConversionType", "ImageType", "BurnedInAnnotation", "SamplesPerPixel", "PhotometricInterpretation"),
    *("PlanarConfiguration", "Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit"),
    *("PixelRepresentation", "PixelData"),
    # structured report
    *("CompletionFlag", "VerificationFlag", "ValueType", "ConceptNameCodeSequence", "ContinuityOfContent"),
    *("ContentTemplateSequence", "MappingResource", "TemplateIdentifier", "ContentSequence"),
    *("RelationshipType", "ConceptCodeSequence", "TextValue", "UID", "MeasuredValueSequence"),
    *("MeasurementUnitsCodeSequence", "NumericValue", "FloatingPointValue", "GraphicType", "GraphicData"),
)


def name_spheres(numbered: Mapping[int, M]) -> dict[str, M]:
    """Name the spheres of a localization M1, M2, ... by their numbers."""
    return {f"M{number}": marker for number, marker in numbered.items()}


def pick_allowed(content: Mapping[str, Any], allowed: Mapping[str, str]) -> dict[str, Any]:
    """Return the allowed fields of a document, in the order of the allow-list."""
    return {name: content[name] for name in allowed if name in content}


def label_of(trajectory: str, number: int) -> str:
    """Return the trajectory's name if it is a plain label, otherwise a label with its number (from 1)."""
    return trajectory if PLAIN_LABEL.fullmatch(trajectory) else f"trajectory{number}"


def require_allowed(dicom_object: Dataset) -> Dataset:
    """Return the object, or raise EXC-004 for an attribute that is unlisted, or filled but must be empty."""
    for element in dicom_object.iterall():
        if element.keyword in EMPTY_ATTRIBUTES and element.is_empty:
            continue
        if element.keyword not in FILLED_ATTRIBUTES:
            raise FIELD_NOT_ALLOWED(f"{element.keyword or element.tag} must not leave the run folder")
    return dicom_object
