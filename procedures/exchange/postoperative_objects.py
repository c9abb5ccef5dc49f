"""Check after the operation as DICOM: structured report, points, and the pose of the later CT."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydicom.dataset import Dataset
from pydicom.uid import Comprehensive3DSRStorage
from scipy.spatial.transform import RigidTransform

from procedures.exchange.allowed_fields import label_of, require_allowed
from procedures.exchange.ct_study import CtStudy
from procedures.exchange.dicom_objects import (
    MAKER,
    NO_MEDICAL_DEVICE,
    REPORT,
    Origin,
    date_content,
    frames_registration,
    new_object,
    point_item,
    spatial_fiducials,
    uid,
    write,
)
from procedures.exchange.errors import REPORT_PACKAGE_MISSING
from procedures.postoperative.comparison import FoundTrajectory
from procedures.postoperative.summary import PostoperativeCheck
from ronna_hw.calibration import Numbers3
from ronna_hw.records import canonical_json

if TYPE_CHECKING:
    from highdicom.sr import CodedConcept, Measurement, MeasurementsAndQualitativeEvaluations

REGISTRATION_FILE = "postoperative-registration.dcm"
POINTS_FILE = "postoperative-points.dcm"
REPORT_FILE = "postoperative-report.dcm"
OWN_CODES = "99RONNA"  # DICOM has no codes for these errors; a private scheme begins with 99
CT_OF_HEAD = ("303653007", "SCT", "CT of head")
MILLIMETRE, DEGREE = ("mm", "UCUM", "mm"), ("deg", "UCUM", "degree")


def check_key(check: PostoperativeCheck, labels: Iterable[str]) -> str:
    """Return the key from which the identifiers of a check's objects with these labels are derived."""
    return hashlib.sha256(canonical_json([check.model_dump(mode="json"), *labels])).hexdigest()


def write_postoperative(
    check: PostoperativeCheck,
    frames: tuple[str, str],
    study_instance_uid: str,
    folder: Path,
    study: CtStudy | None = None,
) -> dict[str, str]:
    """Write the objects of a check, and return what is absent with the reason.

    `frames` are the frame of reference UIDs of the planned and later CT; `study` names the patient. Raises
    EXC-002, EXC-004.
    """
    found = {label_of(one.id, number): one for number, one in enumerate(check.trajectories, 1)}
    key = check_key(check, found)
    origin = Origin(check.pre_series_instance_uid, frames[0], datetime.now(UTC), key, study_instance_uid)
    objects = {
        POINTS_FILE: spatial_fiducials(
            _trajectory_points(found, origin),
            origin,
            "POSTOPERATIVE",
            "planned and found entries and targets",
        )
    }
    absent = {}
    if frames[0] != frames[1]:
        pre_from_post = RigidTransform.from_matrix(np.array(check.post_from_pre)).inv().as_matrix()
        objects[REGISTRATION_FILE] = frames_registration(
            pre_from_post, origin, frames[1], label="POST_TO_PRE", description="registered on bone"
        )
    else:
        absent[REGISTRATION_FILE] = "both CTs claim the same frame of reference"
    if (missing := find_missing_package()) is None:
        objects[REPORT_FILE] = structured_report(found, origin)
    else:
        absent[REPORT_FILE] = missing
    for name, made in objects.items():
        require_allowed(made)
        write(made if study is None else study.file_object(made), folder / name)
    return absent


def find_missing_package() -> str | None:
    """Return why no structured report can be written, or None if one can."""
    if importlib.util.find_spec("highdicom") is not None:
        return None
    error = REPORT_PACKAGE_MISSING("a structured report needs highdicom")
    return f"{error}. {error.action}"


def structured_report(found: Mapping[str, FoundTrajectory], origin: Origin) -> Dataset:
    """Build the Comprehensive 3D SR (template TID 1500) of at least one trajectory by its exported label.

    It has the errors with their units, and the points they come from. Needs the package `highdicom`.
    """
    from highdicom import sr

    observer = sr.ObserverContext(
        observer_type=sr.CodedConcept("121007", "DCM", "Device"),
        observer_identifying_attributes=sr.DeviceObserverIdentifyingAttributes(
            uid=uid(origin, "observer"), manufacturer_name=MAKER, model_name=NO_MEDICAL_DEVICE
        ),
    )
    content = sr.MeasurementReport(
        observation_context=sr.ObservationContext(observer_device_context=observer),
        procedure_reported=sr.CodedConcept(*CT_OF_HEAD),
        imaging_measurements=[_group(one, label, origin) for label, one in found.items()],
    )
    made = new_object(origin, Comprehensive3DSRStorage, REPORT, "errors after the operation")
    date_content(made)
    made.CompletionFlag, made.VerificationFlag = "COMPLETE", "UNVERIFIED"
    made.PerformedProcedureCodeSequence = []
    made.ReferencedPerformedProcedureStepSequence = []
    made.update(content[0])
    return made


def _group(found: FoundTrajectory, label: str, origin: Origin) -> MeasurementsAndQualitativeEvaluations:
    """Build the measurement group of one trajectory. A drilled hole has no tip, so its depth is unknown."""
    from highdicom import sr

    planned, axis = (
        (found.planned_entry_mm, found.planned_target_mm),
        (found.entry_mm, found.axis_at_target_mm),
    )
    entries, targets = zip(planned, axis, strict=True)
    rows = (
        ("ENTRY", "Error at the entry, across the planned trajectory", found.entry_error_mm, (entries,)),
        (
            "TARGET",
            "Error at the target, from the planned target to the tip",
            found.target_error_mm,
            (targets,),
        ),
        ("LATERAL", "Error at the target, across the planned trajectory", found.lateral_mm, (targets,)),
        ("DEPTH", "Depth error, positive is too deep", found.depth_error_mm, (targets,)),
        ("ANGLE", "Angle between planned and found axis", found.angle_deg, (planned, axis)),
    )
    evaluations = [
        sr.QualitativeEvaluation(
            _own_code("FOUND", "Found along the trajectory"),
            _own_code(found.kind.name, found.kind.value),
        )
    ]
    if found.doubts:
        doubtful = _own_code("DOUBTFUL", "doubtful: the fit leaves an unusual residual or radius")
        evaluations.append(sr.QualitativeEvaluation(_own_code("RELIABILITY", "Reliability"), doubtful))
    return sr.MeasurementsAndQualitativeEvaluations(
        tracking_identifier=sr.TrackingIdentifier(uid=uid(origin, "trajectory", label), identifier=label),
        measurements=[
            _measurement(code, meaning, value, lines, origin)
            for code, meaning, value, lines in rows
            if value is not None
        ],
        qualitative_evaluations=evaluations,
    )


def _measurement(
    code: str, meaning: str, value: float, lines: tuple[tuple[Numbers3, ...], ...], origin: Origin
) -> Measurement:
    """Build a measurement with its unit, and the lines in the planning CT that it was taken from."""
    from highdicom import sr

    unit = DEGREE if code == "ANGLE" else MILLIMETRE
    return sr.Measurement(
        name=_own_code(code, meaning),
        value=value,
        unit=sr.CodedConcept(*unit),
        referenced_coordinates=[
            sr.CoordinatesForMeasurement3D(
                graphic_type=sr.GraphicTypeValues3D.POLYLINE,
                graphic_data=np.array(line),
                frame_of_reference_uid=origin.frame_of_reference_uid,
            )
            for line in lines
        ],
    )


def _own_code(code: str, meaning: str) -> CodedConcept:
    from highdicom.sr import CodedConcept

    return CodedConcept(code, OWN_CODES, meaning)


def _trajectory_points(found: Mapping[str, FoundTrajectory], origin: Origin) -> list[Dataset]:
    items = []
    for label, one in found.items():
        places = {
            "PE": ("planned entry", one.planned_entry_mm),
            "PT": ("planned target", one.planned_target_mm),
            "FE": ("found entry", one.entry_mm),
            "FT": ("found tip", one.tip_mm),
        }
        items += [
            point_item(f"{label} {code}", place, origin, f"{what} of {label}")
            for code, (what, place) in places.items()
            if place is not None
        ]
    return items
