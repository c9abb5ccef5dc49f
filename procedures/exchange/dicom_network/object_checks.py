"""Checks of a received object before it gets a name: identifiers, class, and as many pixels as it states."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from procedures.exchange.dicom_network.errors import OBJECT_REFUSED
from procedures.imaging.dicom.attributes import read_attribute_text, read_dicom, read_numbers, read_value
from procedures.imaging.dicom.frame_decoder import check_frame
from ronna_hw.errors import DataError

CT_IMAGE_STORAGE = "1.2.840.10008.5.1.4.1.1.2"
LONGEST_UID = 64  # PS3.5 9.1
PATIENT = ("PatientID", "PatientName", "PatientBirthDate")  # alike in all slices of a series
_UID = re.compile(r"(0|[1-9][0-9]*)(\.(0|[1-9][0-9]*))+")
_BYTES_OF_BITS = {8: 1, 16: 2}


@dataclass(frozen=True, repr=False)  # keeps the patient out of logs
class ReceivedObject:
    """Identifiers of an object that has passed the checks."""

    instance_uid: str
    series_uid: str
    study_uid: str
    patient: tuple[str, ...]  # compared, and stored nowhere but in the object


def require_uid(uid: str, noun: str) -> str:
    """Return a DICOM identifier that can be believed. Raises DCM-009 for anything else, such as a path."""
    if len(uid) <= LONGEST_UID and _UID.fullmatch(uid):
        return uid
    raise OBJECT_REFUSED(f"the {noun} is no DICOM identifier", expected="numbers with dots", got=repr(uid))


def check_object(path: Path, class_uid: str, instance_uid: str) -> ReceivedObject:
    """Check the file of an object against the class and instance that its sender named. Raises DCM-009."""
    require_uid(instance_uid, "SOP Instance UID of the command")
    try:
        data = read_dicom(path)
        stated = {
            keyword: read_attribute_text(path, data, keyword)
            for keyword in (
                *("SOPClassUID", "SOPInstanceUID", "SeriesInstanceUID", "StudyInstanceUID"),
                *PATIENT,
            )
        }
        for keyword, named in (("SOPClassUID", class_uid), ("SOPInstanceUID", instance_uid)):
            if stated[keyword] != named:
                words = f"{keyword} of the object is not that of the command"
                raise OBJECT_REFUSED(words, expected=named, got=repr(stated[keyword]))
        rows, columns, bits = (
            int(read_numbers(path, data, keyword, 1)[0]) for keyword in ("Rows", "Columns", "BitsAllocated")
        )
        pixels = read_value(path, data, "PixelData")
        syntax = data.file_meta.TransferSyntaxUID
        if bits not in _BYTES_OF_BITS or not isinstance(pixels, bytes):
            raise OBJECT_REFUSED("the object has no pixels of 8 or 16 bits")
        if syntax.is_compressed:
            from pydicom.encaps import get_frame

            frame = get_frame(pixels, 0, number_of_frames=1)
            check_frame(syntax, frame, (rows, columns), _BYTES_OF_BITS[bits])
        elif len(pixels) != (needed := _padded(rows * columns * _BYTES_OF_BITS[bits])):
            raise OBJECT_REFUSED(
                "the object has another number of pixels than it states",
                expected=f"{needed} bytes",
                got=f"{len(pixels)}",
            )
    except MemoryError:
        raise
    except Exception as problem:  # foreign bytes can break the parser in any way
        if getattr(problem, "code", "") == OBJECT_REFUSED.code:
            raise
        reason = problem.summary if isinstance(problem, DataError) else type(problem).__name__
        raise OBJECT_REFUSED("the object cannot be read", got=reason) from problem
    return ReceivedObject(
        instance_uid,
        require_uid(stated["SeriesInstanceUID"], "Series Instance UID"),
        require_uid(stated["StudyInstanceUID"], "Study Instance UID"),
        tuple(stated[keyword] for keyword in PATIENT),
    )


def read_patient(path: Path) -> tuple[str, ...]:
    """Return the patient of a slice that is there. Raises CT-002, CT-005."""
    data = read_dicom(path, only=PATIENT)
    return tuple(read_attribute_text(path, data, keyword) for keyword in PATIENT)


def _padded(count: int) -> int:
    return count + count % 2  # values have an even length
