"""Objects to be sent: read, and refused unless all are of one patient and name a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.exchange.dicom_network.errors import NOT_SENDABLE
from procedures.imaging.dicom.attributes import read_attribute_text, read_dicom, require_text
from procedures.imaging.dicom.slice_headers import PatientIdentity, list_dicom_files
from procedures.imaging.errors import SERIES_EMPTY
from ronna_hw.text import printable

if TYPE_CHECKING:
    from pydicom.dataset import FileDataset


def read_objects(paths: Sequence[Path]) -> tuple[list[Path], list[FileDataset]]:
    """Read DICOM files, and those directly in folders. Raises DCM-014, CT-001, CT-002, CT-005, CT-012."""
    files = [file for path in paths for file in (list_dicom_files(path) if path.is_dir() else [path])]
    if not files:
        raise SERIES_EMPTY("there is no DICOM file to send", action="Give files, or the folder of an export.")
    objects = [read_dicom(file) for file in files]
    patients = set()
    for file, one in zip(files, objects, strict=True):
        for keyword in ("SOPClassUID", "SOPInstanceUID"):
            require_text(file, one, keyword)
        for keyword, noun in (("PatientID", "patient"), ("StudyInstanceUID", "study")):
            if not read_attribute_text(file, one, keyword):
                raise NOT_SENDABLE(f"{file.name} names no {noun}")
        patients.add(
            tuple(read_attribute_text(file, one, word) for word in ("PatientID", "PatientBirthDate"))
        )
    if len(patients) > 1:
        raise NOT_SENDABLE(f"the objects are of {len(patients)} patients")
    return files, objects


def describe_owner(objects: Sequence[FileDataset]) -> str:
    """Say whose the objects are, and in how many studies they lie."""
    first = objects[0]
    words = ("PatientName", "PatientID", "PatientBirthDate", "PatientSex")
    patient = PatientIdentity(*(read_attribute_text(Path("object"), first, word) for word in words))
    studies = len({str(one.StudyInstanceUID) for one in objects})
    return printable(f"{patient.describe()}, in {studies} {'study' if studies == 1 else 'studies'},")
