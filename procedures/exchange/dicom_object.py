"""What a registration and a set of fiducials have in common as DICOM objects.

They carry no patient identity unless `name_patient` adds it.

Attributes that DICOM requires but allows to be empty stay empty: a clinical archive fills them in on import.
Identifiers are derived from the content, so the same result always yields the same object.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from io import BytesIO
from pathlib import Path

from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import UID, ExplicitVRLittleEndian, generate_uid

from procedures.exchange.errors import NotWritable
from ronna_hw.records import write_whole

MAKER = "ronna-hw"
NOT_CLINICAL = "research software, not a medical device"


@dataclass(frozen=True)
class Origin:
    """Origin of a result: the CT series, its frame of reference, when it was made, and a key.

    `key`, for example a record's hash, makes the identifiers unique to this result.
    """

    series_instance_uid: str
    frame_of_reference_uid: str
    made: datetime
    key: str


def new_object(origin: Origin, sop_class: UID, modality: str, label: str, description: str) -> Dataset:
    """An object complete except for its content."""
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
    name_patient(made, "", "", "", "")
    for name in ("StudyDate", "StudyTime", "AccessionNumber", "ReferringPhysicianName", "StudyID"):
        setattr(made, name, "")
    made.StudyInstanceUID = uid(origin, "study")
    made.SeriesInstanceUID = uid(origin, modality, "series")
    made.SeriesNumber = 1
    made.InstanceNumber = 1
    made.Modality = modality
    made.Manufacturer = MAKER
    made.ManufacturerModelName = NOT_CLINICAL
    made.DeviceSerialNumber = "none"
    made.SoftwareVersions = version("ronna-hw")
    made.Laterality = ""
    made.ContentDate = origin.made.strftime("%Y%m%d")
    made.ContentTime = origin.made.strftime("%H%M%S")
    made.ContentLabel = label
    made.ContentDescription = description
    made.ContentCreatorName = ""
    return made


def name_patient(made: Dataset, name: str, identifier: str, birth_date: str, sex: str) -> None:
    """Set the patient identity, in the series' own notation (birth date YYYYMMDD)."""
    made.PatientName, made.PatientID = name, identifier
    made.PatientBirthDate, made.PatientSex = birth_date, sex


def instance_uid(origin: Origin, modality: str) -> UID:
    """The SOP instance UID of the object of this modality for a result."""
    return uid(origin, modality, "instance")


def uid(origin: Origin, *what: str) -> UID:
    """A UID derived from the origin and its purpose."""
    return generate_uid(entropy_srcs=[MAKER, origin.series_instance_uid, origin.key, *what])


def code(value: str, scheme: str, meaning: str) -> Dataset:
    """An item of a code sequence."""
    item = Dataset()
    item.CodeValue = value
    item.CodingSchemeDesignator = scheme
    item.CodeMeaning = meaning
    return item


def decimals(values: Sequence[float]) -> list[str]:
    """Numbers as decimal strings of at most 16 characters, with as many digits as fit."""
    return [_decimal(float(value)) for value in values]


def write(made: Dataset, path: Path) -> Path:
    """Write an object as a DICOM file; raises EXC-002."""
    content = BytesIO()
    made.save_as(content, enforce_file_format=True)
    try:
        write_whole(path, content.getvalue())
    except OSError as error:
        raise NotWritable(f"cannot write {path}: {error.strerror}") from error
    return path


def _decimal(value: float) -> str:
    for digits in range(16, 0, -1):
        text = f"{value:.{digits}g}"
        if len(text) <= 16:
            return text
    raise ValueError(f"{value} cannot be written as a DICOM decimal string")
