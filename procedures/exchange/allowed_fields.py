"""Allow-list of the only fields that `export` may write outside a run folder.

No field holds a person's name, number, date of birth, place or device. The series and its frame of reference
are named by their DICOM UIDs: without them no other program could overlay the result on the CT.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from pydicom.dataset import Dataset

from procedures.exchange.errors import FieldNotAllowed

M = TypeVar("M")

# Trajectory names are free text in the plan and may contain a patient's name: only plain labels such as T1 or
# L12 are exported; any other trajectory is identified by its number.
PLAIN_LABEL = re.compile(r"[A-Za-z]{1,3}\d{1,3}")

SPHERE_FIELDS = {
    "centre_mm": "centre in LPS",
    "covariance_mm2": "of the centre",
    "radius_mm": "as measured",
    "quality": "0 to 1",
    "agreement_mm": "between the two estimates of the centre",
    "flags": "fixed words of the localizer",
    "odds": "that it is a marker, 0 to 1",
}
REGISTRATION_FIELDS = {
    "trajectory": "its label, or its number",
    "robot_from_ct": "pose robot <- CT",
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
    "coordinate_system": "LPS",
    "unit": "mm",
    "spheres": "one entry for each sphere",
    "registrations": "one entry for each target",
    "name": "of a sphere: M1, M2, ...",
}
# DICOM attributes, by the standard's keywords; those that must be present but empty come first.
ALWAYS_EMPTY = (
    *("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime"),
    *("AccessionNumber", "ReferringPhysicianName", "StudyID", "Laterality", "ContentCreatorName"),
)
EMPTY_ATTRIBUTES = (*ALWAYS_EMPTY, "PositionReferenceIndicator")  # the last in registrations only
FILLED_ATTRIBUTES = (
    *("SpecificCharacterSet", "SOPClassUID", "SOPInstanceUID", "StudyInstanceUID", "SeriesInstanceUID"),
    *("SeriesNumber", "InstanceNumber", "Modality", "Manufacturer", "ManufacturerModelName"),
    *("DeviceSerialNumber", "SoftwareVersions", "ContentDate", "ContentTime", "ContentLabel"),
    *("ContentDescription", "FrameOfReferenceUID", "FiducialSetSequence", "FiducialSequence"),
    *("FiducialIdentifier", "FiducialDescription", "FiducialUID", "ShapeType", "NumberOfContourPoints"),
    *("ContourData", "ContourUncertaintyRadius", "RegistrationSequence", "MatrixRegistrationSequence"),
    *("RegistrationTypeCodeSequence", "CodeValue", "CodingSchemeDesignator", "CodeMeaning"),
    *("MatrixSequence", "FrameOfReferenceTransformationMatrixType"),
    *("FrameOfReferenceTransformationMatrix", "UsedFiducialsSequence", "ReferencedSOPClassUID"),
    "ReferencedSOPInstanceUID",
)


def name_spheres(markers: Iterable[M]) -> dict[str, M]:
    """Name the spheres of a localization M1, M2, ... in order."""
    return {f"M{number}": marker for number, marker in enumerate(markers, 1)}


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
            raise FieldNotAllowed(f"{element.keyword or element.tag} must not leave the run folder")
    return dicom_object
