"""Writes slices as a DICOM CT or MR series, byte for byte reproducible for the same scene."""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from math import cos, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ronna_hw.phantom_identity import format_patient_id
from ronna_hw.records import write_atomically
from sim.phantom.head.shapes import Values
from sim.phantom.scanner.faults import KERNELS, NO_FAULTS, ScannerFaults
from sim.phantom.scanner.grid import CtGrid
from sim.world.scene.model import Scene

if TYPE_CHECKING:
    from pydicom.dataset import Dataset
    from pydicom.uid import UID

INTERCEPT_HU = -1024
LARGEST_STORED = 4095  # 12 bits
PATIENT_POSITION = "HFS"
SCAN_DATE = "20180601"  # a fixed day: the date must not change the bytes
UID_PREFIX = "2.25."  # UIDs based on a 128-bit number
UID_BITS = 128
COORDINATE_DIGITS = 4
DIRECTION_DIGITS = 10  # of a direction cosine: four would displace the last row of a tilted slice by 0.01 mm
PREAMBLE_BYTES = 128  # DICOM part 10: free bytes before the letters DICM
COMPRESSED_BYTES = (
    20_000_000  # of a series from which JPEG-LS is used: for less, a decoder is not worth its start
)
DESCRIBED, DESCRIBED_BARE = "Head phantom with fiducial spheres", "Head phantom without markers"
FILE_PATTERN = "slice-*.dcm"


class DicomSeries:
    """DICOM series in a folder, with UIDs hashed from the whole scene and the occasion of a later scan."""

    def __init__(
        self,
        scene: Scene,
        grid: CtGrid,
        folder: Path,
        faults: ScannerFaults = NO_FAULTS,
        *,
        occasion: str = "",
        described: str = DESCRIBED,
        date: str = SCAN_DATE,
        intercept_HU: int = INTERCEPT_HU,
        kernel_name: str = "",
        is_mr: bool = False,
    ) -> None:
        self._scene = scene
        self._date, self._intercept_HU = date, intercept_HU
        self._grid = grid
        self._folder = folder
        self._tilt_rad = radians(faults.stated_tilt_deg)
        self._faults = faults
        active = json.dumps(faults.active()) if faults.active() else ""
        content = scene.model_dump_json(by_alias=True) + active + occasion
        self._content = hashlib.sha256(content.encode()).digest()
        self._is_mr = is_mr
        self._described = described
        self._kernel_name = kernel_name or KERNELS[faults.kernel].name
        self.series_instance_uid = self._make_uid("series")
        self._study_uid = self._make_uid("study")
        self._frame_uid = self._make_uid("frame of reference")

    def prepare(self) -> None:
        """Create the folder and remove the slices of an earlier series."""
        self._folder.mkdir(parents=True, exist_ok=True)
        for leftover in self._folder.glob(FILE_PATTERN):
            leftover.unlink()

    def write(self, number: int, stored: NDArray[np.uint16]) -> None:
        """Write one slice of stored values (rows, columns); not thread-safe."""
        from pydicom.dataelem import DataElement
        from pydicom.dataset import Dataset
        from pydicom.uid import UID

        own = Dataset()
        own.SOPInstanceUID = UID(self._make_uid(f"slice {number}"))
        own.InstanceNumber = number + 1
        position = self._first_pixel_mm(number)
        own.ImagePositionPatient = [_format_decimal(value) for value in position]
        own.SliceLocation = _format_decimal(position[2])
        own.add(DataElement("PixelData", "OB" if self._is_compressed else "OW", self._encode(stored)))
        own["PixelData"].is_undefined_length = self._is_compressed
        encoded = self._shared | _encode_elements(own)
        content = b"".join(
            [
                bytes(PREAMBLE_BYTES),
                b"DICM",
                _encode_meta(own.SOPInstanceUID, self._is_compressed, self._is_mr),
            ]
            + [encoded[tag] for tag in sorted(encoded)]
        )
        write_atomically(self._folder / f"slice-{number + 1:04d}.dcm", content, flushed=False)

    def _encode(self, stored: NDArray[np.uint16]) -> bytes:
        if not self._is_compressed:
            return stored.tobytes()
        from jpeg_ls import encode_buffer
        from pydicom.encaps import encapsulate

        rows, columns = stored.shape
        return encapsulate([bytes(encode_buffer(stored.tobytes(), rows, columns, 1, self._bits_stored))])

    def _first_pixel_mm(self, number: int) -> tuple[float, float, float]:
        """Return the first pixel's position in a slice tilted about its middle row."""
        grid, half_mm = self._grid, 0.5 * (self._grid.rows - 1) * self._grid.pixel_mm
        x, y, z = grid.origin_mm
        y += half_mm * (1.0 - cos(self._tilt_rad))
        return x, y, z + number * grid.slice_mm - half_mm * sin(self._tilt_rad)

    @cached_property
    def _shared(self) -> dict[int, bytes]:
        """Encoded attributes common to all slices."""
        from pydicom.dataset import Dataset
        from pydicom.uid import CTImageStorage

        grid, protocol = self._grid, self._scene.ct
        data = Dataset()
        data.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
        data.SOPClassUID = CTImageStorage
        data.StudyDate = data.SeriesDate = data.AcquisitionDate = data.ContentDate = self._date
        data.StudyTime = data.ContentTime = "120000"
        data.AccessionNumber = data.ReferringPhysicianName = ""
        data.Modality = "CT"
        data.Manufacturer = "ronna-sim phantom"
        data.StudyDescription = data.SeriesDescription = self._described
        data.PatientName = "Phantom^Head"
        data.PatientID = format_patient_id(self._scene.name, self._scene.seed)
        data.PatientBirthDate = data.PatientSex = ""
        data.BodyPartExamined = "HEAD"
        data.KVP = "120"
        data.SliceThickness = _format_decimal(self._faults.thickness_mm or grid.slice_mm)
        if not self._faults.tilt_hidden:
            data.GantryDetectorTilt = _format_decimal(self._faults.tilt_deg)
        data.ConvolutionKernel = self._kernel_name
        data.PatientPosition = PATIENT_POSITION
        data.StudyInstanceUID, data.SeriesInstanceUID = self._study_uid, self.series_instance_uid
        data.StudyID, data.SeriesNumber, data.AcquisitionNumber = "1", 1, 1
        data.ImageOrientationPatient = [
            "1",
            "0",
            "0",
            "0",
            _format_decimal(cos(self._tilt_rad), DIRECTION_DIGITS),
            _format_decimal(sin(self._tilt_rad), DIRECTION_DIGITS),
        ]
        data.FrameOfReferenceUID, data.PositionReferenceIndicator = self._frame_uid, ""
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.Rows, data.Columns = protocol.rows, protocol.columns
        data.PixelSpacing = [_format_decimal(grid.pixel_mm)] * 2
        bits = self._bits_stored
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, bits, bits - 1, 0
        data.RescaleIntercept, data.RescaleSlope, data.RescaleType = str(self._intercept_HU), "1", "HU"
        data.WindowCenter, data.WindowWidth = "40", "400"
        if self._is_mr:
            _describe_mr(data)
        return _encode_elements(data)

    @property
    def _is_compressed(self) -> bool:
        grid = self._grid
        return 2 * grid.rows * grid.columns * grid.slices >= COMPRESSED_BYTES

    @property
    def _bits_stored(self) -> int:
        return 16 if self._faults.extended_range else 12

    def _make_uid(self, what: str) -> str:
        digest = hashlib.sha256(self._content + what.encode()).digest()
        return UID_PREFIX + str(int.from_bytes(digest[: UID_BITS // 8], "big"))


def _describe_mr(data: Dataset) -> None:
    """Replace the attributes of a CT by those of an MR, which has no unit of intensity."""
    from pydicom.uid import MRImageStorage

    for keyword in ("KVP", "ConvolutionKernel", "RescaleIntercept", "RescaleSlope", "RescaleType"):
        delattr(data, keyword)
    data.SOPClassUID, data.Modality = MRImageStorage, "MR"
    data.ImageType = ["ORIGINAL", "PRIMARY", "M", "SE"]
    data.ScanningSequence, data.SequenceVariant, data.ScanOptions = "GR", "SP", ""
    data.MRAcquisitionType = "3D"
    data.WindowCenter, data.WindowWidth = "500", "1000"


def _encode_elements(data: Dataset) -> dict[int, bytes]:
    """Encode attributes in explicit VR little endian, keyed by tag."""
    from pydicom.filebase import DicomBytesIO
    from pydicom.filewriter import write_data_element

    encoded = {}
    for element in data:
        stream = DicomBytesIO()
        stream.is_little_endian, stream.is_implicit_VR = True, False
        write_data_element(stream, element)
        encoded[int(element.tag)] = stream.getvalue()
    return encoded


def _encode_meta(instance: UID, is_compressed: bool, is_mr: bool) -> bytes:
    from pydicom.dataset import FileMetaDataset
    from pydicom.filebase import DicomBytesIO
    from pydicom.filewriter import write_file_meta_info
    from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, JPEGLSLossless, MRImageStorage

    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = (
        (MRImageStorage if is_mr else CTImageStorage),
        instance,
    )
    meta.TransferSyntaxUID = JPEGLSLossless if is_compressed else ExplicitVRLittleEndian
    stream = DicomBytesIO()
    stream.is_little_endian, stream.is_implicit_VR = True, False
    write_file_meta_info(stream, meta)
    return stream.getvalue()


def to_stored_values(
    hu: Values, largest: int = LARGEST_STORED, intercept_HU: int = INTERCEPT_HU
) -> NDArray[np.uint16]:
    """Convert HU to stored values, saturating at `largest` as a scanner does."""
    return np.clip(np.rint(hu) - np.float32(intercept_HU), 0, largest).astype("<u2")


def _format_decimal(value: float, digits: int = COORDINATE_DIGITS) -> str:
    """Format a DICOM decimal string of at most 16 characters."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text
