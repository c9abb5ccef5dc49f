"""Headers of the slices in a folder, checked to be one CT series."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.imaging.errors import (
    AttributeMissing,
    FileDamaged,
    FramesMixed,
    SeriesEmpty,
    SeriesMixed,
    SeriesNotFound,
    WrongModality,
)

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileDataset

Progress = Callable[[float], None]

PREAMBLE_BYTES = 128  # DICOM part 10: 128 free bytes, then the letters DICM
MAGIC = b"DICM"
DICOM_SUFFIXES = frozenset({".dcm", ".dicom", ".ima", ".img"})

_DIRECTORY_STORAGE = "1.2.840.10008.1.3.10"
_CT_IMAGE_STORAGE = "1.2.840.10008.5.1.4.1.1.2"
_ENHANCED_CT_STORAGES = frozenset({"1.2.840.10008.5.1.4.1.1.2.1", "1.2.840.10008.5.1.4.1.1.2.2"})

_STANDARD_ROOT = "1.2.840"  # classes of the standard; those of makers begin otherwise
_PRIVATE_DOTS = 5  # fewer: the identifier itself is cut off

_TAGS = (
    "SOPClassUID",
    "Modality",
    "SeriesInstanceUID",
    "FrameOfReferenceUID",
    "PatientPosition",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "PixelSpacing",
    "SliceThickness",
    "GantryDetectorTilt",
    "Rows",
    "Columns",
    "RescaleSlope",
    "RescaleIntercept",
)


@dataclass(frozen=True)
class SliceHeader:
    """What one file says about its slice. Lengths mm, directions and positions LPS."""

    path: Path
    series_instance_uid: str
    frame_of_reference_uid: str
    patient_position: str
    position_mm: tuple[float, ...]
    orientation: tuple[float, ...]
    row_spacing_mm: float
    column_spacing_mm: float
    thickness_mm: float | None
    tilt_deg: float
    rows: int
    columns: int
    slope: float
    intercept: float


def read_headers(directory: Path, progress: Progress | None = None) -> tuple[SliceHeader, ...]:
    """Headers of all CT slices directly in `directory`, in order of file name.

    Files that are not DICOM and DICOM objects without an image are left out. Raises CT-001 to CT-006 and
    CT-012; the message names the file, the series or the frame at fault.
    """
    images = []
    files = _files_in(directory)
    for number, path in enumerate(files):
        header = read_dicom(path, only=_TAGS) if _is_dicom(path) else None
        if header is not None and _is_image(path, header):
            images.append((path, header))
        if progress is not None:
            progress((number + 1) / len(files))
    if not images:
        raise SeriesEmpty(f"no DICOM image in {directory}")
    _refuse_several(
        SeriesMixed, "series", (_text(path, header, "SeriesInstanceUID") for path, header in images)
    )
    _refuse_other_modality(images)
    slices = tuple(_slice_header(path, header) for path, header in images)
    _refuse_several(FramesMixed, "frames of reference", (one.frame_of_reference_uid for one in slices))
    return slices


def read_dicom(path: Path, *, only: tuple[str, ...] | None = None) -> FileDataset:
    """One file as a data set; with `only`, those attributes and no pixels. Raises CT-005 with the name."""
    import pydicom

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # oddities in attributes that are not used here
            if only is None:
                return pydicom.dcmread(path)
            return pydicom.dcmread(path, stop_before_pixels=True, specific_tags=list(only))
    except OSError as problem:
        if problem.errno is None:
            raise FileDamaged(f"{path.name} cannot be read as DICOM ({problem})") from problem
        raise
    except Exception as problem:  # a damaged file can break the parser in any way
        raise FileDamaged(f"{path.name} cannot be read as DICOM ({problem})") from problem


def _files_in(directory: Path) -> list[Path]:
    if not directory.is_dir():
        reason = "is not a folder" if directory.exists() else "does not exist"
        raise SeriesNotFound(f"{directory} {reason}")
    return sorted(path for path in directory.iterdir() if path.is_file() and not path.name.startswith("."))


def _is_dicom(path: Path) -> bool:
    with path.open("rb") as stream:
        start = stream.read(PREAMBLE_BYTES + len(MAGIC))
    if start[PREAMBLE_BYTES:] == MAGIC:
        return True
    cut_short = len(start) < PREAMBLE_BYTES + len(MAGIC) and not any(start)
    if path.suffix.lower() in DICOM_SUFFIXES or (not path.suffix and cut_short):
        raise FileDamaged(f"{path.name} is truncated or not DICOM: the letters DICM are missing")
    return False


def _is_image(path: Path, header: FileDataset) -> bool:
    from pydicom import config
    from pydicom.uid import UID

    stated = _value(path, header.file_meta, "MediaStorageSOPClassUID") or _text(path, header, "SOPClassUID")
    kind = UID(str(stated), validation_mode=config.IGNORE)
    if kind == _DIRECTORY_STORAGE:
        return False
    if "Rows" in header and "Columns" in header:
        return True
    standard_object = kind.name != str(kind) and kind != _CT_IMAGE_STORAGE
    private_object = not kind.startswith(_STANDARD_ROOT) and kind.count(".") >= _PRIVATE_DOTS
    if not (standard_object or private_object):
        raise FileDamaged(f"{path.name} is truncated: its header ends early")
    return False


def _refuse_several(error: type[SeriesMixed | FramesMixed], noun: str, values: Iterable[str]) -> None:
    distinct = sorted(set(values))
    if len(distinct) > 1:
        raise error(
            f"the folder holds {len(distinct)} {noun}: {', '.join(uid or '(none)' for uid in distinct)}"
        )


def _refuse_other_modality(images: list[tuple[Path, FileDataset]]) -> None:
    for path, header in images:
        modality = _text(path, header, "Modality")
        if modality != "CT":
            raise WrongModality(f"{path.name} has modality {modality or '(none)'}", awaited="CT")
        if _text(path, header, "SOPClassUID") in _ENHANCED_CT_STORAGES:
            raise WrongModality(f"{path.name} is a multi-frame (enhanced) CT", awaited="one slice per file")


def _slice_header(path: Path, header: FileDataset) -> SliceHeader:
    spacing = _numbers(path, header, "PixelSpacing", 2)
    rows, columns = int(header.Rows), int(header.Columns)
    if min(spacing) <= 0 or min(rows, columns) < 1:
        raise AttributeMissing(f"{path.name}: pixel spacing {spacing} mm, {rows} rows, {columns} columns")
    slope = _numbers(path, header, "RescaleSlope", 1)[0]
    if slope == 0:
        raise AttributeMissing(f"{path.name}: RescaleSlope is 0")
    thickness = _optional_number(path, header, "SliceThickness")
    return SliceHeader(
        path=path,
        series_instance_uid=_required_text(path, header, "SeriesInstanceUID"),
        frame_of_reference_uid=_required_text(path, header, "FrameOfReferenceUID"),
        patient_position=_text(path, header, "PatientPosition"),
        position_mm=_numbers(path, header, "ImagePositionPatient", 3),
        orientation=_numbers(path, header, "ImageOrientationPatient", 6),
        row_spacing_mm=spacing[0],
        column_spacing_mm=spacing[1],
        thickness_mm=thickness,
        tilt_deg=_optional_number(path, header, "GantryDetectorTilt") or 0.0,
        rows=rows,
        columns=columns,
        slope=slope,
        intercept=_numbers(path, header, "RescaleIntercept", 1)[0],
    )


def _value(path: Path, header: Dataset, keyword: str) -> Any:
    """The decoded value; pydicom decodes only now, so a bad one shows here."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return header.get(keyword)
    except Exception as problem:
        raise AttributeMissing(f"{path.name}: {keyword} is unreadable") from problem


def _numbers(path: Path, header: FileDataset, keyword: str, count: int) -> tuple[float, ...]:
    value = _value(path, header, keyword)
    try:
        numbers = tuple(float(item) for item in ([value] if count == 1 else value))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise AttributeMissing(f"{path.name}: {keyword} is missing or not {count} finite numbers")
    return numbers


def _optional_number(path: Path, header: FileDataset, keyword: str) -> float | None:
    return None if _value(path, header, keyword) in (None, "") else _numbers(path, header, keyword, 1)[0]


def _text(path: Path, header: Dataset, keyword: str) -> str:
    value = _value(path, header, keyword)
    return "" if value is None else str(value).strip()


def _required_text(path: Path, header: FileDataset, keyword: str) -> str:
    text = _text(path, header, keyword)
    if not text:
        raise AttributeMissing(f"{path.name}: {keyword} is missing")
    return text
