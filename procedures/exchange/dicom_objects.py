"""DICOM objects for registrations and fiducials, and what all objects have in common.

They lie in the study of their CT and carry no patient identity unless `CtStudy` adds it. Identifiers are
derived from the content, so the same result always yields the same object.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
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

from procedures.exchange.allowed_fields import IDENTITY, name_spheres
from procedures.exchange.errors import NOT_WRITABLE
from procedures.imaging.markers import Marker
from ronna_hw.frames import Transform
from ronna_hw.records import write_atomically

MAKER = "ronna-hw"
NO_MEDICAL_DEVICE = "research software, not a medical device"
CODE = ("CodeValue", "CodingSchemeDesignator", "CodeMeaning")
FIDUCIAL_ALIGNMENT = ("125022", "DCM", "Fiducial Alignment")
CONTENT_ALIGNMENT = ("125024", "DCM", "Image Content-based Alignment")
FIDUCIALS, REGISTRATION, STRUCTURES, PAGE, REPORT = "FID", "REG", "RTSTRUCT", "OT", "SR"
# Behind the scanner's own series, which count from 1.
SERIES_NUMBERS = {FIDUCIALS: 9001, REGISTRATION: 9002, STRUCTURES: 9003, PAGE: 9004, REPORT: 9005}
BODY_PART = "HEAD"  # no paired one: without it the validator asks for a side
LONGEST_TEXT = 64  # characters of the value representation LO


@dataclass(frozen=True)
class Origin:
    """Origin of a result: CT series, frame of reference, time of creation, a key, and the study of the CT.

    `key`, for example a record's hash, makes the identifiers unique to this result. A CT whose study is not
    known has one of its own, the same for all objects made from it.
    """

    series_instance_uid: str
    frame_of_reference_uid: str
    made: datetime
    key: str
    study_instance_uid: str = ""


def fiducial_uid(origin: Origin, name: str) -> str:
    """Return the UID of a sphere, shared by the fiducials object and the registrations that use it."""
    return str(uid(origin, "fiducial", name))


def sphere_fiducials(
    numbered: Mapping[int, Marker], origin: Origin, description: str = "centres of marker spheres"
) -> Dataset:
    """Build the Spatial Fiducials object for the spheres of a CT series, named M1, M2, ... by number."""
    points = [
        point_item(name, marker.centre_mm, origin, "marker sphere", marker.sigma_mm)
        for name, marker in name_spheres(numbered).items()
    ]
    return spatial_fiducials(points, origin, "MARKERS", description)


def spatial_fiducials(points: list[Dataset], origin: Origin, label: str, description: str) -> Dataset:
    """Build a Spatial Fiducials object from its points, in the frame of the CT."""
    made = _new_content(origin, SpatialFiducialsStorage, FIDUCIALS, label, description)
    group = item(FrameOfReferenceUID=origin.frame_of_reference_uid, FiducialSequence=points)
    made.FiducialSetSequence = [group]
    return made


def point_item(
    name: str, place_mm: Sequence[float], origin: Origin, description: str, uncertainty_mm: float = 0.0
) -> Dataset:
    """Build the item of a point in LPS mm, without an uncertainty of 0; a name has at most 16 characters."""
    point = item(
        FiducialIdentifier=name,
        FiducialDescription=description,
        FiducialUID=fiducial_uid(origin, name),
        ShapeType="POINT",
        NumberOfContourPoints=1,
        ContourData=decimals(place_mm),
    )
    if uncertainty_mm > 0.0:
        point.ContourUncertaintyRadius = uncertainty_mm
    return point


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
        _frame_item(
            origin.frame_of_reference_uid,
            robot_from_ct.as_matrix(),
            comment="robot <- CT: maps points of the CT (LPS, mm) to the robot",
        ),
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
        _frame_item(
            second_frame_uid,
            first_from_second,
            CONTENT_ALIGNMENT,
            comment="first <- second CT: maps points of the second (LPS, mm)",
        ),
    ]
    return _registration(origin, origin.frame_of_reference_uid, items, label, description)


def _registration(
    origin: Origin, frame_uid: str, items: list[Dataset], label: str, description: str
) -> Dataset:
    made = _new_content(origin, SpatialRegistrationStorage, REGISTRATION, label, description)
    made.FrameOfReferenceUID = frame_uid
    made.PositionReferenceIndicator = ""
    made.RegistrationSequence = items
    return made


def item(**attributes: object) -> Dataset:
    """Build an item of a sequence from its attributes, by the standard's keywords."""
    built = Dataset()
    for keyword, value in attributes.items():
        setattr(built, keyword, value)
    return built


def _frame_item(
    frame_of_reference_uid: str,
    matrix: NDArray[np.float64],
    alignment: tuple[str, str, str] = FIDUCIAL_ALIGNMENT,
    comment: str = "",  # VR LO, at most 64 characters
) -> Dataset:
    """Build the item of one frame; its matrix maps that frame into the object's. A comment says which."""
    step = item(
        FrameOfReferenceTransformationMatrixType="RIGID",
        FrameOfReferenceTransformationMatrix=decimals(matrix.ravel().tolist()),
    )
    code = item(**dict(zip(CODE, alignment, strict=True)))
    transform = item(RegistrationTypeCodeSequence=[code], MatrixSequence=[step])
    if comment:  # some readers take the inverse
        transform.FrameOfReferenceTransformationComment = comment
    return item(FrameOfReferenceUID=frame_of_reference_uid, MatrixRegistrationSequence=[transform])


def _used_fiducial_item(fiducial_uid: str, origin: Origin) -> Dataset:
    return item(
        ReferencedSOPClassUID=SpatialFiducialsStorage,
        ReferencedSOPInstanceUID=instance_uid(origin, FIDUCIALS),
        FiducialUID=fiducial_uid,
    )


def _new_content(origin: Origin, sop_class: UID, modality: str, label: str, description: str) -> Dataset:
    """Build an object that identifies its content, as fiducials and registrations do."""
    made = new_object(origin, sop_class, modality, description)
    date_content(made)
    made.BodyPartExamined = BODY_PART
    made.ContentLabel = label
    made.ContentDescription = description[:LONGEST_TEXT]
    made.ContentCreatorName = ""
    return made


def new_object(origin: Origin, sop_class: UID, modality: str, description: str) -> Dataset:
    """Build a DICOM object with what all have in common, in a series of its own in the study of the CT."""
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
    for name in IDENTITY:
        setattr(made, name, "")
    own_study = generate_uid(entropy_srcs=[MAKER, origin.series_instance_uid, "study"])
    made.StudyInstanceUID = origin.study_instance_uid or own_study
    made.SeriesInstanceUID = uid(origin, modality, "series")
    made.SeriesNumber = SERIES_NUMBERS[modality]
    made.SeriesDescription = description[:LONGEST_TEXT]
    made.InstanceNumber = 1
    made.Modality = modality
    made.Manufacturer = MAKER
    made.ManufacturerModelName = NO_MEDICAL_DEVICE
    made.DeviceSerialNumber = "none"
    made.SoftwareVersions = version("ronna-hw")
    made.InstanceCreationDate = origin.made.strftime("%Y%m%d")
    made.InstanceCreationTime = origin.made.strftime("%H%M%S")
    return made


def date_content(made: Dataset) -> None:
    """Date the content of an object of the kinds that do so, as it was created."""
    made.ContentDate, made.ContentTime = made.InstanceCreationDate, made.InstanceCreationTime


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
