"""Slice headers of a folder, checked to form one CT series, and the patient's identity.

The identity is read only on request: volumes, markers, logs and reports contain none.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from procedures.imaging.dicom.attributes import (
    read_attribute_text,
    read_dicom,
    read_numbers,
    read_optional_number,
    read_value,
    require_text,
)
from procedures.imaging.errors import (
    ATTRIBUTE_MISSING,
    FILE_DAMAGED,
    RESCALE_UNUSABLE,
    SCOUT_VIEW,
    SERIES_EMPTY,
    SERIES_NOT_FOUND,
    WRONG_MODALITY,
    FramesMixed,
    SeriesMixed,
)
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import sha256_of
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from pydicom.dataset import FileDataset


Progress = Callable[[float], None]

CT_FOLDER = "ct"  # of the folder of a case, beside its plan
PREAMBLE_BYTES = 128  # DICOM part 10: 128 free bytes, then the letters DICM
MAGIC = b"DICM"
DICOM_SUFFIXES = frozenset({".dcm", ".dicom", ".ima", ".img"})

_DIRECTORY_STORAGE = "1.2.840.10008.1.3.10"
_CT_IMAGE_STORAGE = "1.2.840.10008.5.1.4.1.1.2"
_ENHANCED_STORAGES = frozenset(
    f"1.2.840.10008.5.1.4.1.1.{one}" for one in ("2.1", "2.2", "4.1", "4.3", "4.4", "130", "128.1")
)

_STANDARD_ROOT = "1.2.840"  # SOP classes of the standard; private ones begin otherwise
_PRIVATE_DOTS = 5  # with fewer, the identifier itself is truncated

_SCOUT_WORDS = frozenset({"LOCALIZER", "SCOUT", "TOPOGRAM"})  # the first is that of PS3.3 C.8.2.1.1.1
_DERIVED = "DERIVED"
_LOSSY = "01"
_HOUNSFIELD = frozenset({"", "HU"})
_UNSPECIFIED = frozenset({"US", "HU_MOD"})  # possibly HU: the user is warned
SLOPE_LIMITS = (0.0625, 10.0)  # 16 bits cover 4096 HU; steps no coarser than half the noise of a good scan
SPACING_LIMITS_MM = (0.01, 10.0)  # between a dental micro-CT for mice and no image at all
LARGEST_SIDE = 2048  # pixels; the finest clinical scanners reach this
FARTHEST_MM = 1e5  # from the frame's origin: no hospital is larger
INTERCEPT_LIMIT = 65536.0  # 16 bits, either sign

_IMAGE_TAGS = ("SOPClassUID", "Rows", "Columns")  # these distinguish an image from other objects
_TAGS = (
    "ImageType",
    "LossyImageCompression",
    "ConvolutionKernel",
    "Modality",
    "StudyInstanceUID",
    "SeriesInstanceUID",
    "FrameOfReferenceUID",
    "PatientPosition",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "PixelSpacing",
    "SliceThickness",
    "GantryDetectorTilt",
    "RescaleSlope",
    "RescaleIntercept",
    "RescaleType",
    "InstanceNumber",
    "ImagesInAcquisition",
    "PatientID",  # compared, then discarded
)

CT_ONLY = ("CT",)
FUSED_MODALITIES = ("MR", "PT", "CT")  # of a series that is registered to the CT
_STORED_TAGS = ("BitsStored", "PixelRepresentation")
_FULL_BITS, _UNSIGNED = 16, 0
HALVED = 0.5  # of unsigned values of 16 bits, so that they fit into a volume's

_IDENTITY_TAGS = ("PatientName", "PatientID", "PatientBirthDate", "PatientSex")
_SCAN_DATES = ("AcquisitionDate", "SeriesDate", "StudyDate")  # the nearest to the scan first
_SCAN_TAGS = (*_IDENTITY_TAGS, *_SCAN_DATES, "StudyDescription", "FrameOfReferenceUID")
_DATE_FORMATS = {8: "%Y%m%d", 10: "%Y.%m.%d"}  # by length: DICOM, and ACR-NEMA before it


@dataclass(frozen=True)
class SliceHeader:
    """Header of one slice. Lengths in mm, directions and positions in LPS."""

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
    number: float | None  # counted from 1, as a rule
    stated_count: float | None  # of all images of the acquisition
    kernel: str = ""  # of the reconstruction, as the scanner names it
    study_instance_uid: str = ""
    oddities: tuple[str, ...] = ()  # of its origin: reasons to doubt it
    modality: str = "CT"


def read_headers(
    directory: Path, progress: Progress | None = None, modalities: tuple[str, ...] = CT_ONLY
) -> tuple[SliceHeader, ...]:
    """Read the headers of all CT slices directly in `directory`, in file name order.

    Slices of other `modalities` keep their stored values, as these have no unit in common. Skips non-DICOM
    files and DICOM objects without an image. Raises CT-001 to CT-006, CT-012, CT-020, CT-021; the message
    names the offending file, series or frame of reference.
    """
    images = read_images(directory, _TAGS + _STORED_TAGS, progress)
    _refuse_scouts(images)
    series = [(read_attribute_text(path, header, "SeriesInstanceUID"), path) for path, header in images]
    _refuse_mixed(SeriesMixed, "series", series)
    _refuse_mixed_patients(images)
    _refuse_other_modality(images, modalities)
    slices = tuple(_parse_slice_header(path, header) for path, header in images)
    frames = [(one.frame_of_reference_uid, one.path) for one in slices]
    _refuse_mixed(FramesMixed, "frames of reference", frames)
    return slices


def read_images(
    directory: Path, tags: tuple[str, ...], progress: Progress | None = None
) -> list[tuple[Path, FileDataset]]:
    """Read `tags` of every DICOM image directly in `directory`. Raises CT-001, CT-002, CT-005."""
    images = list(iterate_images(directory, tags, progress))
    if not images:
        _refuse_empty(directory)
    return images


def _refuse_empty(directory: Path) -> NoReturn:
    """Raise CT-002, naming the folders one level deeper that hold DICOM files."""
    holding: dict[Path, int] = {}
    for path in sorted(one for one in directory.iterdir() if one.is_dir()):
        with suppress(RonnaError, OSError):  # a damaged neighbour is not what was asked for
            holding |= {path: count} if (count := len(list_dicom_files(path))) else {}
    if not holding:
        raise SERIES_EMPTY(f"no DICOM image in {directory}")
    counted = ", ".join(
        f"{format_count(count, 'DICOM file')} in {one.name}" for one, count in holding.items()
    )
    series = directory / CT_FOLDER if directory / CT_FOLDER in holding else next(iter(holding))
    raise SERIES_EMPTY(
        f"no DICOM image directly in {directory}, but {counted}",
        action=f"Give the folder of the series itself, such as {series}, or move its files up.",
    )


def iterate_images(
    directory: Path, tags: tuple[str, ...], progress: Progress | None = None
) -> Iterator[tuple[Path, FileDataset]]:
    """Yield the path and attributes of each DICOM image, if any, directly in `directory`."""
    files = _list_files(directory)
    for number, path in enumerate(files):
        header = read_dicom(path, only=_IMAGE_TAGS + tags) if _is_dicom(path) else None
        if header is not None and _is_image(path, header):
            yield path, header
        if progress is not None:
            progress((number + 1) / len(files))


def list_dicom_files(directory: Path) -> list[Path]:
    """List the DICOM files directly in `directory`. Raises CT-001, CT-005."""
    return [path for path in _list_files(directory) if _is_dicom(path)]


def _list_files(directory: Path) -> list[Path]:
    if not directory.is_dir():
        reason = "is not a folder" if directory.exists() else "does not exist"
        raise SERIES_NOT_FOUND(f"{directory} {reason}")
    entries = [path for path in directory.iterdir() if not path.name.startswith(".") and not path.is_dir()]
    for path in entries:
        if path.suffix.lower() in ("", *DICOM_SUFFIXES) and not path.is_file():
            defect = "is a link that leads to no file" if path.is_symlink() else "is not a regular file"
            raise FILE_DAMAGED(f"{path.name} {defect}", expected="a slice, or no file of that name")
    return sorted(path for path in entries if path.is_file())


def _is_dicom(path: Path) -> bool:
    with path.open("rb") as stream:
        start = stream.read(PREAMBLE_BYTES + len(MAGIC))
    if start[PREAMBLE_BYTES:] == MAGIC:
        return True
    cut_short = len(start) < PREAMBLE_BYTES + len(MAGIC) and not any(start)
    if path.suffix.lower() in DICOM_SUFFIXES or (not path.suffix and cut_short):
        raise FILE_DAMAGED(f"{path.name} is truncated or not DICOM: the letters DICM are missing")
    return False


def _is_image(path: Path, header: FileDataset) -> bool:
    from pydicom import config
    from pydicom.uid import UID

    stated = read_value(path, header.file_meta, "MediaStorageSOPClassUID") or read_attribute_text(
        path, header, "SOPClassUID"
    )
    kind = UID(str(stated), validation_mode=config.IGNORE)
    if kind == _DIRECTORY_STORAGE:
        return False
    if "Rows" in header and "Columns" in header:
        return True
    standard_object = kind.name != str(kind) and kind != _CT_IMAGE_STORAGE
    private_object = not kind.startswith(_STANDARD_ROOT) and kind.count(".") >= _PRIVATE_DOTS
    if not (standard_object or private_object):
        raise FILE_DAMAGED(f"{path.name} is truncated: its header ends early")
    return False


def _refuse_mixed(
    error: type[SeriesMixed | FramesMixed], noun: str, stated: Iterable[tuple[str, Path]]
) -> None:
    files = defaultdict[str, list[str]](list)
    for uid, path in stated:
        files[uid].append(path.name)
    if len(files) > 1:
        listed = (
            f"{uid or '(none)'} in {format_count(len(names), 'file')}, such as {min(names)}"
            for uid, names in sorted(files.items())
        )
        raise error(f"the folder holds {len(files)} {noun}: {'; '.join(listed)}")


def _refuse_mixed_patients(images: list[tuple[Path, FileDataset]]) -> None:
    count = len({read_attribute_text(path, header, "PatientID") for path, header in images} - {""})
    if count > 1:  # messages must not identify patients
        raise SeriesMixed(f"the slices of one series name {count} patients")


def _refuse_other_modality(images: list[tuple[Path, FileDataset]], modalities: tuple[str, ...]) -> None:
    for path, header in images:
        modality = read_attribute_text(path, header, "Modality")
        if modality not in modalities:
            expected = " or ".join(modalities)
            raise WRONG_MODALITY(f"{path.name} has modality {modality or '(none)'}", expected=expected)
        if read_attribute_text(path, header, "SOPClassUID") in _ENHANCED_STORAGES:
            raise WRONG_MODALITY(
                f"{path.name} is a multi-frame (enhanced) {modality}", expected="one slice per file"
            )
    if len({read_attribute_text(path, header, "Modality") for path, header in images}) > 1:
        raise WRONG_MODALITY("the slices are of several modalities", expected="one")


def _refuse_scouts(images: list[tuple[Path, FileDataset]]) -> None:
    for path, header in images:
        if scout := _SCOUT_WORDS.intersection(_read_image_type(path, header)):
            raise SCOUT_VIEW(f"{path.name} has image type {min(scout)}", expected="slices")


def _parse_slice_header(path: Path, header: FileDataset) -> SliceHeader:
    spacing = read_numbers(path, header, "PixelSpacing", 2)
    rows, columns = (int(read_numbers(path, header, keyword, 1)[0]) for keyword in ("Rows", "Columns"))
    if not (SPACING_LIMITS_MM[0] <= min(spacing) and max(spacing) <= SPACING_LIMITS_MM[1]):
        raise ATTRIBUTE_MISSING(
            f"{path.name}: pixel spacing of {spacing[0]:g} x {spacing[1]:g} mm",
            limit=f"{SPACING_LIMITS_MM[0]:g} to {SPACING_LIMITS_MM[1]:g} mm",
        )
    if not 1 <= min(rows, columns) <= max(rows, columns) <= LARGEST_SIDE:
        raise ATTRIBUTE_MISSING(f"{path.name} has {rows} x {columns} pixels", limit=f"1 to {LARGEST_SIDE}")
    position_mm = read_numbers(path, header, "ImagePositionPatient", 3)
    if (farthest_mm := max(map(abs, position_mm))) > FARTHEST_MM:
        words = f"{path.name} is {farthest_mm:g} mm away from the origin"
        raise ATTRIBUTE_MISSING(words, limit=f"{FARTHEST_MM:g} mm")
    modality = read_attribute_text(path, header, "Modality")
    is_ct = modality in CT_ONLY
    slope, intercept = _read_rescale(path, header) if is_ct else _scale_stored(path, header)
    thickness = read_optional_number(path, header, "SliceThickness")
    return SliceHeader(
        path=path,
        series_instance_uid=require_text(path, header, "SeriesInstanceUID"),
        frame_of_reference_uid=require_text(path, header, "FrameOfReferenceUID"),
        patient_position=read_attribute_text(path, header, "PatientPosition"),
        position_mm=position_mm,
        orientation=read_numbers(path, header, "ImageOrientationPatient", 6),
        row_spacing_mm=spacing[0],
        column_spacing_mm=spacing[1],
        thickness_mm=thickness,
        tilt_deg=read_optional_number(path, header, "GantryDetectorTilt") or 0.0,
        rows=rows,
        columns=columns,
        slope=slope,
        intercept=intercept,
        number=read_optional_number(path, header, "InstanceNumber"),
        stated_count=read_optional_number(path, header, "ImagesInAcquisition"),
        kernel=read_attribute_text(path, header, "ConvolutionKernel"),
        study_instance_uid=read_attribute_text(path, header, "StudyInstanceUID"),
        oddities=_list_oddities(path, header) if is_ct else (),
        modality=modality,
    )


def _scale_stored(path: Path, header: FileDataset) -> tuple[float, float]:
    """Return slope and intercept that fit the stored values of another series into 16 signed bits."""
    bits, kind = (read_optional_number(path, header, keyword) for keyword in _STORED_TAGS)
    return (HALVED if bits == _FULL_BITS and kind == _UNSIGNED else 1.0), 0.0


def _read_rescale(path: Path, header: FileDataset) -> tuple[float, float]:
    """Return the slope and intercept for rescaling to HU. Raises CT-012, CT-020."""
    slope = read_numbers(path, header, "RescaleSlope", 1)[0]
    intercept = read_numbers(path, header, "RescaleIntercept", 1)[0]
    low, high = SLOPE_LIMITS
    if not low <= slope <= high:
        raise RESCALE_UNUSABLE(
            f"{path.name}: RescaleSlope is {slope:g}", limit=f"{low:g} to {high:g} HU per stored step"
        )
    if abs(intercept) > INTERCEPT_LIMIT:
        raise RESCALE_UNUSABLE(
            f"{path.name}: RescaleIntercept is {intercept:g}", limit=f"±{INTERCEPT_LIMIT:g} HU"
        )
    kind = read_attribute_text(path, header, "RescaleType").upper()
    if kind not in _HOUNSFIELD | _UNSPECIFIED:
        raise RESCALE_UNUSABLE(f"{path.name}: RescaleType is {kind}", expected="HU")
    return slope, intercept


def _list_oddities(path: Path, header: FileDataset) -> tuple[str, ...]:
    warnings = []
    if _read_image_type(path, header)[:1] == (_DERIVED,):
        warnings.append("derived images: resampled or filtered by another program after the scanner")
    if read_attribute_text(path, header, "LossyImageCompression") == _LOSSY:
        warnings.append("lossy compression: edges may have moved")
    if read_attribute_text(path, header, "RescaleType").upper() in _UNSPECIFIED:
        warnings.append("the unit of the intensities is unspecified: assuming Hounsfield units")
    if not read_attribute_text(path, header, "ConvolutionKernel"):
        warnings.append(
            "no reconstruction kernel is named: the stated errors hold from soft to sharp kernels, not for "
            "an unknown filter; ask for the series with its kernel"
        )
    return tuple(warnings)


def _read_image_type(path: Path, header: FileDataset) -> tuple[str, ...]:
    stated = read_value(path, header, "ImageType") or ()
    words = (stated,) if isinstance(stated, str) else stated
    return tuple(str(word).strip().upper() for word in words)


@dataclass(frozen=True, repr=False)  # keeps it out of logs
class PatientIdentity:
    """Patient data of a series, verbatim; missing attributes are empty."""

    name: str
    identifier: str
    birth_date: str  # YYYYMMDD
    sex: str

    def as_dict(self) -> dict[str, str]:
        """Return the identity as plain data for JSON."""
        return asdict(self)

    def describe(self) -> str:
        """Describe the patient in one line for display."""
        parts = [self.name or "no name", f"identifier {self.identifier or '(none)'}"]
        if self.birth_date:
            parts.append(f"born {self.birth_date}")
        if self.sex:
            parts.append(f"sex {self.sex}")
        return ", ".join(parts)


@dataclass(frozen=True, repr=False)  # keeps it out of logs
class ScanIdentity:
    """Whose scan a series is, and which, verbatim; missing attributes are empty."""

    patient: PatientIdentity
    date: str  # YYYYMMDD, before the year 2000 perhaps YYYY.MM.DD
    study: str  # its description
    frame_of_reference_uid: str


def parse_date(text: str) -> date | None:
    """Return a date as DICOM or ACR-NEMA write it, or None if it is none."""
    try:
        return datetime.strptime(text, _DATE_FORMATS[len(text)]).replace(tzinfo=UTC).date()
    except (KeyError, ValueError):
        return None


def read_scan_identity(directory: Path) -> ScanIdentity:
    """Read the identity of a scan from its first slice that names a patient, else from the first one.

    Raises CT-001, CT-002, CT-005, CT-012.
    """
    first = None
    for path, header in iterate_images(directory, _SCAN_TAGS):
        first = first or (path, header)
        if read_attribute_text(path, header, "PatientID"):
            return _parse_scan_identity(path, header)
    if first is None:
        _refuse_empty(directory)
    return _parse_scan_identity(*first)


def _parse_scan_identity(path: Path, header: FileDataset) -> ScanIdentity:
    dates = (read_attribute_text(path, header, keyword) for keyword in _SCAN_DATES)
    return ScanIdentity(
        PatientIdentity(*(read_attribute_text(path, header, keyword) for keyword in _IDENTITY_TAGS)),
        date=next(filter(None, dates), ""),
        study=read_attribute_text(path, header, "StudyDescription"),
        frame_of_reference_uid=read_attribute_text(path, header, "FrameOfReferenceUID"),
    )


def read_identity(directory: Path) -> PatientIdentity:
    """Read the patient identity, as `read_scan_identity` does; `read_series` checks that all slices agree."""
    return read_scan_identity(Path(directory)).patient


def hash_series(series: Path) -> str:
    """Return the SHA-256 of the names and contents of the DICOM files in a folder. Raises CT-001, CT-005."""
    listed = "".join(f"{path.name} {sha256_of(path)}\n" for path in list_dicom_files(series))
    return hashlib.sha256(listed.encode()).hexdigest()
