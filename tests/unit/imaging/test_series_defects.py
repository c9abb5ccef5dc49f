"""Every defect of a series is refused with its own error code and the name of the file."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest
from coded_errors import raises
from pydicom.dataelem import RawDataElement
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.tag import Tag
from pydicom.uid import MPEG2MPML, MRImageStorage, RLELossless
from spoiled_slices import every, only, setting

from procedures.imaging import Volume, VoxelGeometry, errors, read_series
from procedures.imaging.dicom.frame_decoder import FrameDecoder, NotDecoded
from ronna_hw.errors import DataError

Write = Callable[..., Path]
HU = np.arange(5 * 6 * 7, dtype=np.int16).reshape(5, 6, 7) - 1000  # what the fixture writes by default


Spoil = Callable[[Path], None]


def cut(name: str, size: int) -> Spoil:
    return lambda folder: os.truncate(folder / name, size)


def cut_by(name: str, missing: int) -> Spoil:
    return lambda folder: os.truncate(folder / name, (folder / name).stat().st_size - missing)


def moved(data: Dataset, sideways_mm: float, along_mm: float = 0.0) -> None:
    x, y, z = (float(value) for value in data.ImagePositionPatient)
    data.ImagePositionPatient = [x + sideways_mm, y, z + along_mm]


def spelling(keyword: str, text: bytes) -> Callable[[Dataset], None]:
    """An edit that no writer allows: the bytes of a value."""

    def change(data: Dataset) -> None:
        tag = pydicom.datadict.tag_for_keyword(keyword)
        data[tag] = RawDataElement(Tag(tag), "DS", len(text), text, 0, False, True)

    return change


def decimal_pixels(data: Dataset) -> None:
    data.FloatPixelData = np.full((data.Rows, data.Columns), np.nan, dtype="<f4").tobytes()
    del data.PixelData


EDITED = {
    "mixed series": (only(2, setting(SeriesInstanceUID="1.2.3.4")), errors.SeriesMixed, "1.2.3.4"),
    "two patients": (only(2, setting(PatientID="SECRET-TOO")), errors.SeriesMixed, "name 2 patients"),
    "another modality": (
        every(setting(Modality="MR", SOPClassUID=MRImageStorage)),
        errors.WRONG_MODALITY,
        "MR",
    ),
    "enhanced CT": (
        every(setting(SOPClassUID="1.2.840.10008.5.1.4.1.1.2.1")),
        errors.WRONG_MODALITY,
        "multi-frame",
    ),
    "two frames": (only(1, setting(FrameOfReferenceUID="1.2.3.9")), errors.FramesMixed, "1.2.3.9"),
    "stated tilt": (every(setting(GantryDetectorTilt="12.5")), errors.GANTRY_TILTED, "12.5"),
    "sheared stack": (lambda data, at: moved(data, 0.05 * at), errors.GANTRY_TILTED, "stacked"),
    "skewed orientation": (
        every(setting(ImageOrientationPatient=["1", "0", "0", "0.1", "0.995", "0"])),
        errors.ORIENTATION_UNUSABLE,
        "perpendicular",
    ),
    "mirrored rows": (
        every(setting(ImageOrientationPatient=["-1", "0", "0", "0", "1", "0"])),
        errors.SERIES_MIRRORED,
        r"as seen from the head.*HFS.*got -1",
    ),
    "turned slice": (
        only(3, setting(ImageOrientationPatient=["0.8", "0.6", "0", "-0.6", "0.8", "0"])),
        errors.ORIENTATION_UNUSABLE,
        "0003.dcm",
    ),
    "same place twice": (only(3, lambda data: moved(data, 0.0, -1.0)), errors.SLICE_DUPLICATED, "0003.dcm"),
    "uneven spacing": (only(2, lambda data: moved(data, 0.0, 0.2)), errors.SPACING_UNEVEN, "0002.dcm"),
    "shifted slice": (only(2, lambda data: moved(data, 0.3)), errors.SPACING_UNEVEN, "sideways"),
    "other pixels": (only(2, setting(PixelSpacing=["0.5", "0.6"])), errors.SLICES_DIFFER, "0002.dcm"),
    "no position": (
        only(2, lambda data: data.pop("ImagePositionPatient")),
        errors.ATTRIBUTE_MISSING,
        "0002.dcm",
    ),
    "no rescale": (only(2, lambda data: data.pop("RescaleSlope")), errors.ATTRIBUTE_MISSING, "RescaleSlope"),
    "slope zero": (
        only(2, setting(RescaleSlope="0")),
        errors.RESCALE_UNUSABLE,
        "0002.dcm: RescaleSlope is 0",
    ),
    "negative slope": (every(setting(RescaleSlope="-1")), errors.RESCALE_UNUSABLE, "RescaleSlope is -1"),
    "huge slope": (every(setting(RescaleSlope="1e9")), errors.RESCALE_UNUSABLE, r"RescaleSlope is 1e\+09"),
    "tiny slope": (every(setting(RescaleSlope="1e-9")), errors.RESCALE_UNUSABLE, "RescaleSlope is 1e-09"),
    "slope not a number": (
        every(spelling("RescaleSlope", b"NaN ")),
        errors.ATTRIBUTE_MISSING,
        "RescaleSlope is unusable; expected a finite number, got NaN",
    ),
    "intercept not a number": (
        every(spelling("RescaleIntercept", b"inf ")),
        errors.ATTRIBUTE_MISSING,
        "RescaleIntercept",
    ),
    "absurd intercept": (
        every(setting(RescaleIntercept="-1e6")),
        errors.RESCALE_UNUSABLE,
        "RescaleIntercept is -1e",
    ),
    "another quantity": (every(setting(RescaleType="ED")), errors.RESCALE_UNUSABLE, "RescaleType is ED"),
    "scout view": (
        only(0, setting(ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])),
        errors.SCOUT_VIEW,
        "0000.dcm has image type LOCALIZER",
    ),
    "scouts alone": (
        every(setting(ImageType=["DERIVED", "SECONDARY", "TOPOGRAM"])),
        errors.SCOUT_VIEW,
        "TOPOGRAM",
    ),
    "several frames": (
        every(setting(NumberOfFrames=2)),
        errors.PIXELS_UNUSABLE,
        "several frames; expected NumberOfFrames of 1, got 2",
    ),
    "colour": (
        every(setting(SamplesPerPixel=3)),
        errors.PIXELS_UNUSABLE,
        "colour; expected SamplesPerPixel of 1, got 3",
    ),
    "decimal pixels": (every(decimal_pixels), errors.PIXELS_UNUSABLE, "floating-point"),
    "no frame": (
        every(lambda data: data.pop("FrameOfReferenceUID")),
        errors.ATTRIBUTE_MISSING,
        "FrameOfReferenceUID",
    ),
    "flat pixels": (every(setting(PixelSpacing=["0", "0.5"])), errors.ATTRIBUTE_MISSING, "pixel spacing"),
    "inverted": (
        every(setting(PhotometricInterpretation="MONOCHROME1")),
        errors.PIXELS_UNUSABLE,
        "MONOCHROME1",
    ),
    "neither signed nor unsigned": (
        every(setting(PixelRepresentation=7)),
        errors.PIXELS_UNUSABLE,
        "pixel representation 7",
    ),
    "bits beyond the word": (every(setting(BitsStored=12, HighBit=17)), errors.PIXELS_UNUSABLE, "bit 17"),
}


@pytest.mark.parametrize("defect", EDITED)
@pytest.mark.hazard(8)
def test_a_defective_header_is_refused(dicom_series: Write, defect: str) -> None:
    edit, error, named = EDITED[defect]
    with raises(error, match=named) as caught:
        read_series(dicom_series(HU, edit=edit))
    assert isinstance(caught.value, DataError)
    assert "secret" not in str(caught.value).lower()


@pytest.mark.hazard(9)
def test_a_mixed_series_is_refused_with_both_identifiers(dicom_series: Write) -> None:
    with pytest.raises(errors.SeriesMixed, match=r"1\.2\.3\.4") as caught:
        read_series(dicom_series(HU, edit=only(0, setting(SeriesInstanceUID="1.2.3.4"))))
    assert "1.2.826.0.1.3680043.8.498.1" in str(caught.value)


SPOILED = {
    "no preamble": (cut("0002.dcm", 60), errors.FILE_DAMAGED, "0002.dcm"),
    "nothing at all": (cut("0002.dcm", 0), errors.FILE_DAMAGED, "0002.dcm"),
    "cut in the meta header": (cut("0002.dcm", 150), errors.FILE_DAMAGED, "0002.dcm"),
    "cut in the header": (cut("0002.dcm", 600), errors.FILE_DAMAGED, "0002.dcm"),
    "cut in the pixels": (cut_by("0002.dcm", 20), errors.FILE_DAMAGED, "0002.dcm"),
    "a slice is missing": (
        lambda folder: (folder / "0002.dcm").unlink(),
        errors.SPACING_UNEVEN,
        "1 slice missing",
    ),
    "two slices are left": (
        lambda folder: [(folder / f"000{n}.dcm").unlink() for n in range(3)],
        errors.SERIES_TOO_SHORT,
        "2 slices",
    ),
    "a copy": (
        lambda folder: (folder / "copy.dcm").write_bytes((folder / "0003.dcm").read_bytes()),
        errors.SLICE_DUPLICATED,
        "copy.dcm",
    ),
    "empty folder": (
        lambda folder: [path.unlink() for path in folder.iterdir()],
        errors.SERIES_EMPTY,
        "series",
    ),
    "one level too deep": (
        lambda folder: [
            (folder / "ST000001").mkdir(),
            *(path.rename(folder / "ST000001" / path.name) for path in sorted(folder.glob("*.dcm"))),
        ],
        errors.SERIES_EMPTY,
        r"directly in .*, but 5 DICOM files in ST000001\. Give the folder .*/ST000001",
    ),
    "not DICOM": (
        lambda folder: [
            path.rename(path.with_suffix(".txt")).write_text("x" * 200) for path in folder.iterdir()
        ],
        errors.SERIES_EMPTY,
        "no DICOM image",
    ),
}


@pytest.mark.parametrize("defect", SPOILED)
@pytest.mark.hazard(8)
def test_a_defective_folder_is_refused(dicom_series: Write, defect: str) -> None:
    folder = dicom_series()
    spoil, error, named = SPOILED[defect]
    spoil(folder)
    with raises(error, match=named):
        read_series(folder)


def test_every_gap_in_a_series_still_being_copied_is_named(dicom_series: Write) -> None:
    folder = dicom_series(np.zeros((8, 6, 7), dtype=np.int16))
    for name in ("0001.dcm", "0005.dcm"):
        (folder / name).unlink()
    gaps = r"2 slices missing between 0000\.dcm and 0002\.dcm, between 0004\.dcm and 0006\.dcm;"
    with raises(errors.SPACING_UNEVEN, match=f"{gaps} .* still being copied"):
        read_series(folder)


def test_different_matrix_sizes_are_refused(dicom_series: Write) -> None:
    def smaller(data: Dataset) -> None:
        data.Rows, data.PixelData = 5, data.PixelData[: 5 * 7 * 2]

    with raises(errors.SLICES_DIFFER, match="5 x 7"):
        read_series(dicom_series(HU, edit=only(1, smaller)))


def test_a_file_truncated_at_any_length_is_named(dicom_series: Write) -> None:
    folder = dicom_series()
    whole = (folder / "0002.dcm").read_bytes()
    for size in range(0, len(whole), 7):
        (folder / "0002.dcm").write_bytes(whole[:size])
        with raises(errors.FILE_DAMAGED, errors.ATTRIBUTE_MISSING, match=r"0002\.dcm"):
            read_series(folder)


@pytest.mark.parametrize(
    ("syntax", "error"),
    [(MPEG2MPML, errors.COMPRESSION_UNKNOWN), (RLELossless, errors.FILE_DAMAGED)],
    ids=["no decoder exists", "the decoder finds nonsense"],
)
def test_compressed_pixels_that_cannot_be_decoded_are_refused(
    dicom_series: Write, syntax: str, error: type[DataError]
) -> None:
    def change(data: Dataset) -> None:
        data.file_meta.TransferSyntaxUID = syntax
        data.PixelData = encapsulate([bytes(60)])
        data["PixelData"].VR = "OB"
        data["PixelData"].is_undefined_length = True

    with raises(error, match=r"0000\.dcm"):
        read_series(dicom_series(HU, edit=every(change)))


@pytest.mark.parametrize("name", ["missing", "file"])
def test_a_path_that_is_not_a_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("x")
    with raises(errors.SERIES_NOT_FOUND, match=name):
        read_series(tmp_path / name)


@pytest.mark.parametrize(
    "spoiled",
    [
        {"voxels": np.full((5, 6, 7), np.nan)},
        {"voxels": np.zeros((5, 6), dtype=np.int16)},
        {"voxels": np.zeros((5, 6, 8), dtype=np.int16)},
        {"origin_mm": np.array([0.0, np.nan, 0.0])},
        {"origin_mm": np.zeros(2)},
        {"axes": np.ones((3, 3))},
        {"spacing_mm": np.array([1.0, 0.0, 1.0])},
        {"shape": (5, 6, 0)},
    ],
    ids=[
        "NaN",
        "flat",
        "other shape",
        "origin NaN",
        "origin of two",
        "skew axes",
        "no spacing",
        "no columns",
    ],
)
def test_a_volume_built_by_hand_is_validated_too(spoiled: dict[str, object]) -> None:
    sound = {"shape": (5, 6, 7), "origin_mm": np.zeros(3), "axes": np.eye(3), "spacing_mm": np.ones(3)}
    voxels = spoiled.get("voxels", HU)
    geometry = sound | {name: value for name, value in spoiled.items() if name != "voxels"}
    with raises(errors.VOLUME_MALFORMED) as caught:
        Volume(voxels, VoxelGeometry(**geometry), "1.2.3", "1.2.4")
    assert isinstance(caught.value, ValueError)


ENCODERS = {"JPEG lossless": ("dcmcjpeg", "+e1"), "JPEG-LS": ("dcmcjpls", "+el")}


@pytest.mark.parametrize("syntax", ENCODERS)
@pytest.mark.parametrize("decoder", ["installed", "missing"])
def test_slices_compressed_by_dcmtk_are_read_or_refused_naming_the_missing_extra(
    dicom_series: Write, monkeypatch: pytest.MonkeyPatch, syntax: str, decoder: str
) -> None:
    program, lossless = ENCODERS[syntax]
    if shutil.which(program) is None:
        pytest.skip(f"proof by {program} not made: install Debian's dcmtk")
    folder = dicom_series()
    for path in folder.iterdir():
        subprocess.run([program, lossless, str(path), str(path)], check=True, capture_output=True)
    if decoder == "installed" or syntax == "JPEG-LS":  # which needs no extra
        if syntax != "JPEG-LS":
            pytest.importorskip("gdcm", reason="proof not made: install the extra `compressed`")
        np.testing.assert_array_equal(read_series(folder).voxels, HU)
        return
    monkeypatch.setattr("procedures.imaging.series.can_decode", lambda syntax: False)
    monkeypatch.setattr(FrameDecoder, "decode", _no_decoder)
    with raises(errors.COMPRESSION_UNKNOWN, match=r"ronna-hw\[compressed\]"):
        read_series(folder)


def _no_decoder(_decoder: FrameDecoder, _path: Path) -> None:
    raise NotDecoded("no decoder")
