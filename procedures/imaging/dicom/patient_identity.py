"""Patient identity of a series, read only on request: volumes, markers, logs and reports contain none."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from procedures.imaging.dicom.attributes import text
from procedures.imaging.dicom.slice_headers import images_of, read_images

_TAGS = ("PatientName", "PatientID", "PatientBirthDate", "PatientSex")


@dataclass(frozen=True, repr=False)  # keeps it out of logs
class PatientIdentity:
    """What a series states about its patient, verbatim; empty where it states nothing."""

    name: str
    identifier: str
    birth_date: str  # YYYYMMDD
    sex: str

    def as_dict(self) -> dict[str, str]:
        """For JSON."""
        return asdict(self)

    def describe(self) -> str:
        """One line for display."""
        parts = [self.name or "no name", f"identifier {self.identifier or '(none)'}"]
        if self.birth_date:
            parts.append(f"born {self.birth_date}")
        if self.sex:
            parts.append(f"sex {self.sex}")
        return ", ".join(parts)


def patient_identifier(directory: Path) -> str:
    """The patient ID of the slices in `directory`; empty if they have none. Raises CT-001, CT-005."""
    borne = (text(path, header, "PatientID") for path, header in images_of(directory, ("PatientID",)))
    return next(filter(None, borne), "")


def read_identity(directory: Path) -> PatientIdentity:
    """The patient named by the first slice in `directory`; reading the series checks that all slices agree.

    Raises CT-001, CT-002, CT-005, CT-012.
    """
    path, header = read_images(Path(directory), _TAGS)[0]
    return PatientIdentity(*(text(path, header, keyword) for keyword in _TAGS))
