"""Patient and study of a CT, under which an archive files the objects that were made from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pydicom import config
from pydicom.datadict import dictionary_VR, tag_for_keyword
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset

from procedures.exchange.allowed_fields import IDENTITY
from procedures.exchange.errors import CT_OF_NO_PATIENT, OTHER_CT
from procedures.imaging.dicom.attributes import read_attribute_text
from procedures.imaging.dicom.slice_headers import PatientIdentity, read_images

PATIENT, STUDY = "PatientID", "StudyInstanceUID"
NAMES = {
    PATIENT: ("patient identifier", "patient identifiers"),
    "PatientName": ("patient name", "patient names"),
    "PatientBirthDate": ("birth date", "birth dates"),
    STUDY: ("study", "studies"),
}
NEEDED = (PATIENT, STUDY)  # the others may be empty
COPIED = (*IDENTITY, STUDY)
SERIES, SLICE = "SeriesInstanceUID", "SOPInstanceUID"


@dataclass(frozen=True, repr=False)  # keeps it out of logs
class CtStudy:
    """Attributes of patient and study, verbatim by keyword, and the UIDs of the CT's slices."""

    attributes: Mapping[str, str]
    slice_uids: tuple[str, ...]

    def describe(self) -> str:
        """Describe patient and study in one line for display."""
        words = ("PatientName", PATIENT, "PatientBirthDate", "PatientSex")
        patient = PatientIdentity(*(self.attributes[word] for word in words))
        accession = self.attributes["AccessionNumber"] or "(none)"
        return f"{patient.describe()}; study {self.attributes[STUDY]}, accession number {accession}"

    def file_object(self, made: Dataset) -> Dataset:
        """Return the object as one of this patient and study."""
        for keyword, value in self.attributes.items():
            tag = tag_for_keyword(keyword)
            assert tag is not None, "the standard has all of them"
            # Not validated: the archive finds the study by the values that it already has.
            made[tag] = DataElement(tag, dictionary_VR(tag), value, validation_mode=config.IGNORE)
        return made


def read_ct_study(folder: Path, series_instance_uid: str, study_instance_uid: str = "") -> CtStudy:
    """Read patient and study of the CT series that an object was made from, in this study if it is known.

    Raises EXC-007 for another series or study, EXC-008 without a patient or study, or with several, CT-001,
    CT-002, CT-005, CT-012.
    """
    texts = [
        {keyword: read_attribute_text(path, header, keyword) for keyword in (*COPIED, SERIES, SLICE)}
        for path, header in read_images(folder, (*COPIED, SERIES, SLICE))
    ]
    found = sorted({one[SERIES] for one in texts})
    if found != [series_instance_uid]:
        raise OTHER_CT(
            f"{folder} holds another CT", expected=f"series {series_instance_uid}", got=", ".join(found)
        )
    for keyword, (name, names) in NAMES.items():
        count = len({one[keyword] for one in texts} - {""})
        if count > 1 or (count == 0 and keyword in NEEDED):  # messages never name patients
            raise CT_OF_NO_PATIENT(f"the CT names {count} {names}", expected=f"one {name}", got=str(count))
    first = next(one for one in texts if one[PATIENT])
    (study,) = {one[STUDY] for one in texts} - {""}
    if study_instance_uid and study != study_instance_uid:
        raise OTHER_CT(f"{folder} is in another study", expected=study_instance_uid, got=study)
    copied = {keyword: first[keyword] for keyword in COPIED} | {STUDY: study}
    return CtStudy(copied, tuple(one[SLICE] for one in texts))
