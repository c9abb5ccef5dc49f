"""A series is read faithfully or refused with the reason; its geometry is never guessed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest
from coded_errors import raises
from jpeg_ls import encode_buffer
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate, get_frame
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    JPEGLSLossless,
    RLELossless,
)
from spoiled_slices import every, only, setting

from procedures.imaging import read_series
from procedures.imaging.errors import FILE_DAMAGED

Write = Callable[..., Path]
HU = np.arange(5 * 6 * 7, dtype=np.int16).reshape(5, 6, 7) - 1000  # what the fixture writes by default


def test_voxel_values_and_geometry_are_read_unchanged(dicom_series: Write) -> None:
    volume = read_series(dicom_series())
    np.testing.assert_array_equal(volume.voxels, HU)
    assert volume.voxels.dtype == np.int16
    assert volume.geometry.shape == (5, 6, 7)
    assert volume.series_instance_uid.endswith(".498.1")
    assert volume.frame_of_reference_uid.endswith(".498.2")
    assert (volume.patient_position, volume.geometry.orientation) == ("HFS", "LPS")
    assert volume.warnings == ()
    with pytest.raises(ValueError, match="read-only"):
        volume.voxels[0, 0, 0] = 1


def test_coordinates_refer_to_voxel_centres_and_row_spacing_comes_first(dicom_series: Write) -> None:
    geometry = read_series(dicom_series(HU, (1.25, 0.9, 0.4))).geometry
    # slice 2, row 3, column 4 of a series whose first voxel is centred on (-20, -30, 40)
    expected = [-20 + 4 * 0.4, -30 + 3 * 0.9, 40 + 2 * 1.25]
    np.testing.assert_allclose(geometry.to_patient_mm([2, 3, 4]), expected, atol=1e-9)
    np.testing.assert_allclose(geometry.to_index(expected), [2, 3, 4], atol=1e-9)


def test_slices_are_ordered_by_position_and_not_by_file_name_or_instance_number(dicom_series: Write) -> None:
    volume = read_series(dicom_series(HU, reverse=True))
    np.testing.assert_array_equal(volume.voxels, HU)
    np.testing.assert_allclose(volume.geometry.origin_mm, [-20, -30, 40])


def test_an_oblique_series_maps_every_voxel_to_its_patient_position(dicom_series: Write) -> None:
    row = np.array([0.8, 0.6, 0.0])
    column = np.array([-0.36, 0.48, -0.8])
    normal = np.cross(row, column)
    volume = read_series(
        dicom_series(HU, (2.0, 0.5, 0.7), row_direction=tuple(row), column_direction=tuple(column))
    )
    index = np.array([[0, 0, 0], [4, 5, 6], [1.5, 2.25, 0.5]])
    expected = (
        np.array([-20, -30, 40])
        + index[:, :1] * 2.0 * normal
        + index[:, 1:2] * 0.5 * column
        + index[:, 2:] * 0.7 * row
    )
    np.testing.assert_allclose(volume.geometry.to_patient_mm(index), expected, atol=1e-5)
    np.testing.assert_allclose(volume.geometry.to_index(expected), index, atol=1e-5)


def test_a_sagittal_series_reports_the_directions_of_its_axes(dicom_series: Write) -> None:
    path = dicom_series(HU, row_direction=(0.0, 1.0, 0.0), column_direction=(0.0, 0.0, -1.0))
    assert read_series(path).geometry.orientation == "PIR"


@pytest.mark.parametrize(
    "syntax", [ImplicitVRLittleEndian, DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian, RLELossless]
)
def test_every_lossless_syntax_without_a_plug_in_is_read(dicom_series: Write, syntax: str) -> None:
    def change(data: Dataset) -> None:
        if syntax == RLELossless:
            data.compress(RLELossless, generate_instance_uid=False)
            return
        data.file_meta.TransferSyntaxUID = syntax
        if syntax == ExplicitVRBigEndian:
            data.PixelData = np.frombuffer(data.PixelData, "<i2").astype(">i2").tobytes()

    np.testing.assert_array_equal(read_series(dicom_series(HU, edit=every(change))).voxels, HU)


def in_jpeg_ls(bits: int) -> Callable[[Dataset], None]:
    def compress(data: Dataset) -> None:
        data.BitsStored, data.HighBit = bits, bits - 1
        stored = np.frombuffer(data.PixelData, "<u2") & np.uint16(2**bits - 1)
        frame = encode_buffer(stored.tobytes(), data.Rows, data.Columns, 1, bits)
        data.PixelData = encapsulate([bytes(frame)])
        data["PixelData"].VR = "OB"
        data.file_meta.TransferSyntaxUID = JPEGLSLossless

    return compress


@pytest.mark.parametrize("bits", [12, 16])
def test_signed_values_in_a_jpeg_ls_frame_keep_their_sign(dicom_series: Write, bits: int) -> None:
    voxels = HU - np.int16(500)  # stored as HU + 1024: of either sign
    edit = every(in_jpeg_ls(bits))
    np.testing.assert_array_equal(read_series(dicom_series(voxels, edit=edit)).voxels, voxels)


def test_slices_of_one_series_may_differ_in_their_compression(dicom_series: Write) -> None:
    def compress(data: Dataset, at: int) -> None:
        if at in (0, 1, 3):
            in_jpeg_ls(12)(data)
        elif at == 2:
            data.compress(RLELossless, generate_instance_uid=False)

    np.testing.assert_array_equal(read_series(dicom_series(HU, edit=compress)).voxels, HU)


def test_a_frame_that_cannot_be_decoded_is_named_although_the_next_slice_is_read_by_then(
    dicom_series: Write,
) -> None:
    def compress(data: Dataset, at: int) -> None:
        in_jpeg_ls(12)(data)
        if at == 2:
            frame = get_frame(data.PixelData, 0, number_of_frames=1)
            data.PixelData = encapsulate([frame[: len(frame) // 2]])
            data["PixelData"].VR = "OB"

    with raises(FILE_DAMAGED, match=r"CT-005: 0002\.dcm: its pixel data cannot be decoded"):
        read_series(dicom_series(HU, edit=compress))


def stored(values: np.ndarray, **attributes: object) -> Callable[[Dataset, int], None]:
    def edit(data: Dataset, at: int) -> None:
        setting(**attributes)(data)
        data.PixelData = values[at].tobytes()

    return edit


@pytest.mark.parametrize(
    ("values", "attributes"),
    [
        ((HU + 1024).astype("<u2") | 0x3000, {"BitsStored": 12, "HighBit": 11, "PixelRepresentation": 0}),
        (
            HU.astype("<u2") & 0x0FFF,
            {"BitsStored": 12, "HighBit": 11, "PixelRepresentation": 1, "RescaleIntercept": "0"},
        ),
        (
            (HU.astype(np.int32) + 40000).astype("<u2"),
            {"PixelRepresentation": 0, "RescaleIntercept": "-40000"},
        ),
    ],
    ids=["unsigned with overlay bits", "signed without sign extension", "unsigned beyond the signed range"],
)
def test_every_way_of_storing_a_value_is_read(
    dicom_series: Write, values: np.ndarray, attributes: dict[str, object]
) -> None:
    edit = stored(values, **attributes)
    np.testing.assert_array_equal(read_series(dicom_series(HU, edit=edit)).voxels, HU)


def test_a_value_that_cannot_be_held_is_cut_and_does_not_wrap(dicom_series: Write) -> None:
    values = np.full(HU.shape, 50000, dtype="<u2")
    edit = stored(values, PixelRepresentation=0, RescaleIntercept="-10000")
    assert read_series(dicom_series(HU, edit=edit)).voxels.max() == 32767


def test_a_slope_is_applied_per_slice(dicom_series: Write) -> None:
    edit = only(2, setting(RescaleSlope="0.5", RescaleIntercept="-1000.25"))
    volume = read_series(dicom_series(HU, edit=edit))
    np.testing.assert_array_equal(volume.voxels[1], HU[1])
    np.testing.assert_array_equal(volume.voxels[2], np.rint((HU[2] + 1024.0) * 0.5 - 1000.25))


def test_other_files_and_objects_without_pixels_are_ignored(dicom_series: Write) -> None:
    folder = dicom_series()
    (folder / "plan.toml").write_text("text")
    (folder / "README").write_text("text" * 50)
    (folder / ".hidden.dcm").write_bytes(b"")
    (folder / "sub").mkdir()
    report = pydicom.dcmread(folder / "0000.dcm")
    for keyword in ("Rows", "Columns", "PixelData"):
        delattr(report, keyword)
    report.SOPClassUID = report.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66.1"
    report.Modality, report.SeriesInstanceUID = "REG", "1.2.3"
    report.save_as(folder / "registration.dcm", enforce_file_format=True)
    np.testing.assert_array_equal(read_series(folder).voxels, HU)


@pytest.mark.hazard(8)
def test_thick_slices_gaps_and_large_pixels_give_warnings(dicom_series: Write) -> None:
    path = dicom_series(HU, (3.0, 1.2, 1.2), edit=every(setting(SliceThickness="2.5")))
    thick, gaps, pixels = read_series(path).warnings
    assert "3.00 mm" in thick
    assert "gaps" in gaps
    assert "1.20 mm" in pixels


@pytest.mark.hazard(8)
@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"ImageType": ["DERIVED", "SECONDARY", "REFORMATTED"]}, "derived images"),
        ({"LossyImageCompression": "01"}, "lossy compression"),
        ({"ConvolutionKernel": ""}, "no reconstruction kernel is named"),
        ({"RescaleType": "US"}, "unit of the intensities is unspecified"),
        ({"RescaleIntercept": "0"}, "no air in the scan, the darkest voxel has 24 HU"),
        ({"ImagesInAcquisition": 7}, "the scanner states 7 images in the acquisition, the folder has 5"),
        ({"InstanceNumber": 3}, "the slices are numbered from 3: those before are missing"),
    ],
    ids=["derived", "lossy", "kernel", "unit", "no air", "fewer than stated", "the first missing"],
)
def test_a_series_of_doubtful_origin_gives_a_warning(
    dicom_series: Write, attributes: dict[str, object], words: str
) -> None:
    (warning,) = read_series(dicom_series(HU, edit=every(setting(**attributes)))).warnings
    assert words in warning


def test_progress_reaches_one(dicom_series: Write) -> None:
    shares: list[float] = []
    read_series(dicom_series(), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.hazard(35)
def test_patient_data_is_not_in_the_repr_of_the_volume(dicom_series: Write) -> None:
    assert "secret" not in repr(read_series(dicom_series())).lower()


UNUSUAL = {
    "not axial": {"row_direction": (0.0, 1.0, 0.0), "column_direction": (0.0, 0.0, -1.0)},
    "seen from the head": {"row_direction": (-1.0, 0.0, 0.0), "edit": every(setting(PatientPosition="FFS"))},
    "numbered against their normal": {"reverse": True},
}


@pytest.mark.hazard(7)
@pytest.mark.parametrize("named", UNUSUAL)
def test_an_unusual_orientation_or_order_of_slices_is_named(dicom_series: Write, named: str) -> None:
    assert any(named in warning for warning in read_series(dicom_series(HU, **UNUSUAL[named])).warnings)
