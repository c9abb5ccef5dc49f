"""DICOM objects for registrations, fiducials and the postoperative check.

They carry no patient identity unless `name_patient` adds it. Attributes that DICOM requires but allows to be
empty stay empty: a clinical archive fills them in on import. Identifiers are derived from the content, so the
same result always yields the same object.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import (
    UID,
    ExplicitVRLittleEndian,
    SpatialFiducialsStorage,
    SpatialRegistrationStorage,
    generate_uid,
)
from scipy.spatial.transform import RigidTransform

from procedures.exchange.allowed_fields import ALWAYS_EMPTY, label_of, name_spheres, require_allowed
from procedures.exchange.errors import NOT_WRITABLE
from procedures.imaging.markers import Marker
from procedures.postoperative.summary import PostoperativeCheck
from ronna_hw.frames import Transform
from ronna_hw.records import canonical_json, write_atomically

MAKER = "ronna-hw"
NO_MEDICAL_DEVICE = "research software, not a medical device"
CODE = ("CodeValue", "CodingSchemeDesignator", "CodeMeaning")
FIDUCIAL_ALIGNMENT = ("125022", "DCM", "Fiducial Alignment")
CONTENT_ALIGNMENT = ("125024", "DCM", "Image Content-based Alignment")
REGISTRATION_FILE = "postoperative-registration.dcm"
POINTS_FILE = "postoperative-points.dcm"


@dataclass(frozen=True)
class Origin:
    """Origin of a result: CT series, frame of reference, time of creation, and a key.

    `key`, for example a record's hash, makes the identifiers unique to this result.
    """

    series_instance_uid: str
    frame_of_reference_uid: str
    made: datetime
    key: str


def fiducial_uid(origin: Origin, name: str) -> str:
    """Return the UID of a sphere, shared by the fiducials object and the registrations that use it."""
    return str(uid(origin, "fiducial", name))


def sphere_fiducials(markers: Sequence[Marker], origin: Origin) -> Dataset:
    """Build the Spatial Fiducials object for the spheres of a CT series, named M1, M2, ... in order."""
    points = [
        _point(name, marker.centre_mm, origin, "marker sphere", marker.sigma_mm)
        for name, marker in name_spheres(markers).items()
    ]
    return _spatial_fiducials(points, origin, "MARKERS", "centres of marker spheres")


def _spatial_fiducials(points: list[Dataset], origin: Origin, label: str, description: str) -> Dataset:
    made = new_object(origin, SpatialFiducialsStorage, "FID", label, description)
    group = _item(FrameOfReferenceUID=origin.frame_of_reference_uid, FiducialSequence=points)
    made.FiducialSetSequence = [group]
    return made


def _point(
    name: str, place_mm: Sequence[float], origin: Origin, description: str, uncertainty_mm: float = 0.0
) -> Dataset:
    """Build the fiducial item for a point in LPS mm. A 3-D rms uncertainty of 0 is omitted."""
    item = _item(
        FiducialIdentifier=name,
        FiducialDescription=description,
        FiducialUID=fiducial_uid(origin, name),
        ShapeType="POINT",
        NumberOfContourPoints=1,
        ContourData=decimals(place_mm),
    )
    if uncertainty_mm > 0.0:
        item.ContourUncertaintyRadius = uncertainty_mm
    return item


def spatial_registration(
    robot_from_ct: Transform,
    origin: Origin,
    *,
    spheres: Origin | None = None,
    placing: str = "",
    description: str = "",
    fiducial_uids: Sequence[str] = (),
) -> Dataset:
    """Build the Spatial Registration object for a pose robot <- CT.

    Its own frame of reference is the robot's; the pose maps the CT's into it. `fiducial_uids` name the
    spheres used by the fit, in the fiducials object of the origin `spheres` (by default the same). All
    registrations made from the same spheres with the cart at the same `placing` share one robot frame; once
    the cart has moved, it is a different one.
    """
    spheres = spheres or origin
    robot_uid = uid(spheres, "robot frame", placing)
    items = [
        _frame_item(robot_uid, np.eye(4)),
        _frame_item(origin.frame_of_reference_uid, robot_from_ct.as_matrix()),
    ]
    made = _registration(origin, robot_uid, items, "CT_TO_ROBOT", description)
    if fiducial_uids:
        made.RegistrationSequence[1].UsedFiducialsSequence = [
            _used_fiducial_item(one, spheres) for one in fiducial_uids
        ]
    return made


def frames_registration(
    first_from_second: NDArray[np.float64],
    origin: Origin,
    second_frame_uid: str,
    *,
    label: str,
    description: str,
) -> Dataset:
    """Build the Spatial Registration object for the pose (4, 4) mm of a second CT in the origin's frame."""
    items = [
        _frame_item(origin.frame_of_reference_uid, np.eye(4), CONTENT_ALIGNMENT),
        _frame_item(second_frame_uid, first_from_second, CONTENT_ALIGNMENT),
    ]
    return _registration(origin, origin.frame_of_reference_uid, items, label, description)


def _registration(
    origin: Origin, frame_uid: str, items: list[Dataset], label: str, description: str
) -> Dataset:
    made = new_object(origin, SpatialRegistrationStorage, "REG", label, description)
    made.FrameOfReferenceUID = frame_uid
    made.PositionReferenceIndicator = ""
    made.RegistrationSequence = items
    return made


def _item(**attributes: object) -> Dataset:
    """Build an item of a sequence from its attributes, by the standard's keywords."""
    item = Dataset()
    for keyword, value in attributes.items():
        setattr(item, keyword, value)
    return item


def _frame_item(
    frame_of_reference_uid: str,
    matrix: NDArray[np.float64],
    alignment: tuple[str, str, str] = FIDUCIAL_ALIGNMENT,
) -> Dataset:
    step = _item(
        FrameOfReferenceTransformationMatrixType="RIGID",
        FrameOfReferenceTransformationMatrix=decimals(matrix.ravel().tolist()),
    )
    code = _item(**dict(zip(CODE, alignment, strict=True)))
    transform = _item(RegistrationTypeCodeSequence=[code], MatrixSequence=[step])
    return _item(FrameOfReferenceUID=frame_of_reference_uid, MatrixRegistrationSequence=[transform])


def _used_fiducial_item(fiducial_uid: str, origin: Origin) -> Dataset:
    return _item(
        ReferencedSOPClassUID=SpatialFiducialsStorage,
        ReferencedSOPInstanceUID=instance_uid(origin, "FID"),
        FiducialUID=fiducial_uid,
    )


def write_postoperative(check: PostoperativeCheck, frames: tuple[str, str], folder: Path) -> tuple[Path, ...]:
    """Write fiducials and registration. `frames` are the frame of reference UIDs of the planned and later CT.

    The registration is left out when both CTs claim the same frame of reference. Raises EXC-002, EXC-004.
    """
    key = hashlib.sha256(canonical_json(check.model_dump(mode="json"))).hexdigest()
    origin = Origin(check.pre_series_instance_uid, frames[0], datetime.now(UTC), key)
    points = _spatial_fiducials(
        _trajectory_points(check, origin), origin, "POSTOPERATIVE", "planned and found entries and targets"
    )
    written = [write(require_allowed(points), folder / POINTS_FILE)]
    if frames[0] != frames[1]:
        pre_from_post = RigidTransform.from_matrix(np.array(check.post_from_pre)).inv().as_matrix()
        registration = frames_registration(
            pre_from_post, origin, frames[1], label="POST_TO_PRE", description="registered on bone"
        )
        written.append(write(require_allowed(registration), folder / REGISTRATION_FILE))
    return tuple(written)


def _trajectory_points(check: PostoperativeCheck, origin: Origin) -> list[Dataset]:
    found = []
    for number, one in enumerate(check.trajectories, start=1):
        label = label_of(one.id, number)
        places = {
            "planned entry": one.planned_entry_mm,
            "planned target": one.planned_target_mm,
            "entry": one.entry_mm,
            "tip": one.tip_mm,
        }
        found += [
            _point(f"{label} {what}", place, origin, "point of a trajectory")
            for what, place in places.items()
            if place is not None
        ]
    return found


def new_object(origin: Origin, sop_class: UID, modality: str, label: str, description: str) -> Dataset:
    """Build a DICOM object with all attributes except its content."""
    instance = instance_uid(origin, modality)
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = sop_class
    meta.MediaStorageSOPInstanceUID = instance
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    made = Dataset()
    made.file_meta = meta
    made.SpecificCharacterSet = "ISO_IR 192"
    made.SOPClassUID = sop_class
    made.SOPInstanceUID = instance
    for name in ALWAYS_EMPTY:
        setattr(made, name, "")
    made.StudyInstanceUID = uid(origin, "study")
    made.SeriesInstanceUID = uid(origin, modality, "series")
    made.SeriesNumber = 1
    made.InstanceNumber = 1
    made.Modality = modality
    made.Manufacturer = MAKER
    made.ManufacturerModelName = NO_MEDICAL_DEVICE
    made.DeviceSerialNumber = "none"
    made.SoftwareVersions = version("ronna-hw")
    made.ContentDate = origin.made.strftime("%Y%m%d")
    made.ContentTime = origin.made.strftime("%H%M%S")
    made.ContentLabel = label
    made.ContentDescription = description
    return made


def name_patient(made: Dataset, name: str, identifier: str, birth_date: str, sex: str) -> None:
    """Set the patient identity in DICOM notation (birth date YYYYMMDD)."""
    made.PatientName, made.PatientID = name, identifier
    made.PatientBirthDate, made.PatientSex = birth_date, sex


def instance_uid(origin: Origin, modality: str) -> UID:
    """Return the SOP instance UID of a result's object of this modality."""
    return uid(origin, modality, "instance")


def uid(origin: Origin, *what: str) -> UID:
    """Return a UID derived from the origin and the strings in `what`."""
    return generate_uid(entropy_srcs=[MAKER, origin.series_instance_uid, origin.key, *what])


def decimals(values: Sequence[float]) -> list[str]:
    """Format numbers as DICOM decimal strings of at most 16 characters, as precisely as they allow."""
    return [_decimal(float(value)) for value in values]


def encode(made: Dataset) -> bytes:
    """Return the content of the DICOM file of an object."""
    content = BytesIO()
    made.save_as(content, enforce_file_format=True)
    return content.getvalue()


def write(made: Dataset, path: Path) -> Path:
    """Write an object as a DICOM file. Raises EXC-002."""
    try:
        write_atomically(path, encode(made))
    except OSError as error:
        raise NOT_WRITABLE(f"cannot write {path}: {error.strerror}") from error
    return path


def _decimal(value: float) -> str:
    for digits in range(16, 0, -1):
        text = f"{value:.{digits}g}"
        if len(text) <= 16:
            return text
    raise ValueError(f"{value} cannot be written as a DICOM decimal string")
