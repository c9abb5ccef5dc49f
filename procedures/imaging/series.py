"""Reader for a folder's DICOM CT series: validated geometry, pixels in HU; and for a series beside it."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.dicom.attributes import (
    read_attribute_text,
    read_dicom,
    read_optional_number,
    read_value,
)
from procedures.imaging.dicom.frame_decoder import (
    JPEG_LS,
    FrameDecoder,
    NotDecoded,
    can_decode,
    check_frame,
    read_jpeg_bits,
)
from procedures.imaging.dicom.slice_headers import (
    CT_ONLY,
    FUSED_MODALITIES,
    Progress,
    SliceHeader,
    read_headers,
)
from procedures.imaging.dicom.slice_stack import accuracy_warnings, stack_slices
from procedures.imaging.errors import COMPRESSION_UNKNOWN, FILE_DAMAGED, PIXELS_UNUSABLE, RESCALE_UNUSABLE
from procedures.imaging.scan_faults import check_motion
from procedures.imaging.volume import Volume, VoxelGeometry
from ronna_hw.arguments import require_path
from ronna_hw.bounded_input import InputRefused

if TYPE_CHECKING:
    from pydicom.dataset import FileDataset


HU_LIMITS = (-32768, 32767)

UNSIGNED, SIGNED = 0, 1  # PS3.3 C.7.6.3.1, Pixel Representation
# The last is deflated as a whole.
_LITTLE_ENDIAN_UNCOMPRESSED = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.1.99")

HEADER_SHARE = 0.4  # of the reading time
AIR_BELOW_HU = -500  # every head is surrounded by air

MAY_BE_SOUND = "The file may be sound: see that memory is free, and read it again."


def read_series(directory: Path, *, progress: Progress | None = None) -> Volume:
    """Read the CT series whose files are directly in `directory`.

    Returns voxels in HU with their position in patient coordinates (LPS, mm). `progress` is called with the
    fraction done. Raises CT-001 to CT-015, CT-020, CT-021, CT-023 for a series that cannot be trusted;
    nothing is guessed. Raises ARG-001 for what is no path.
    """
    slices, geometry, voxels = _read_stack(directory, progress, CT_ONLY)
    warnings_found = (
        *accuracy_warnings(slices, geometry),
        *_check_intensities(voxels),
        *check_motion(voxels, geometry),
    )
    return _build_volume(slices, geometry, voxels, warnings_found)


def read_other_series(directory: Path, *, progress: Progress | None = None) -> tuple[Volume, str]:
    """Read a series of another modality, such as an MR, and return it with that modality.

    Its voxels are stored values, whose unit and scale are its own. Raises like `read_series`, and CT-020 for
    slices on scales of their own, as in some PET series.
    """
    slices, geometry, voxels = _read_stack(directory, progress, FUSED_MODALITIES)
    modality = slices[0].modality
    if modality in CT_ONLY:
        return _build_volume(slices, geometry, voxels, accuracy_warnings(slices, geometry)), modality
    scales = {_read_scale(one) for one in slices}
    if len(scales) > 1:
        raise RESCALE_UNUSABLE(
            f"the slices of the {modality} are on {len(scales)} scales",
            expected="one RescaleSlope and RescaleIntercept for all slices",
        )
    return _build_volume(slices, geometry, voxels, ()), modality


def _read_scale(one: SliceHeader) -> tuple[float, float]:
    header = read_dicom(one.path, only=("RescaleSlope", "RescaleIntercept"))
    slope = read_optional_number(one.path, header, "RescaleSlope")
    return 1.0 if slope is None else slope, read_optional_number(one.path, header, "RescaleIntercept") or 0.0


def _read_stack(
    directory: Path, progress: Progress | None, modalities: tuple[str, ...]
) -> tuple[tuple[SliceHeader, ...], VoxelGeometry, NDArray[np.int16]]:
    directory = require_path(directory, "the folder of the series")
    headers = read_headers(directory, _scale_progress(progress, 0.0, HEADER_SHARE), modalities)
    slices, geometry = stack_slices(headers)
    voxels = np.empty(geometry.shape, dtype=np.int16)
    report = _scale_progress(progress, HEADER_SHARE, 1.0)
    with FrameDecoder() as decoder:
        reading: Iterator[None] = iter(())
        for number, header in enumerate(slices):
            before, reading = reading, read_pixels(voxels[number], header, decoder)
            next(reading, None)  # parsed and checked while the frame before it is decoded
            next(before, None)
            next(reading, None)
            deque(before, maxlen=0)  # to its end
            report((number + 1) / len(slices))
        deque(reading, maxlen=0)
    voxels.flags.writeable = False
    return slices, geometry, voxels


def _build_volume(
    slices: tuple[SliceHeader, ...],
    geometry: VoxelGeometry,
    voxels: NDArray[np.int16],
    warnings_found: tuple[str, ...],
) -> Volume:
    return Volume(
        voxels=voxels,
        geometry=geometry,
        series_instance_uid=slices[0].series_instance_uid,
        frame_of_reference_uid=slices[0].frame_of_reference_uid,
        patient_position=slices[0].patient_position,
        study_instance_uid=slices[0].study_instance_uid,
        kernel=", ".join(sorted({one.kernel for one in slices if one.kernel})),
        warnings=warnings_found,
    )


def read_pixels(target: NDArray[np.int16], header: SliceHeader, decoder: FrameDecoder) -> Iterator[None]:
    """Read the HU of one slice into `target` (rows, columns).

    Pauses before the decoder gets its frame, while the frame is decoded, and afterwards, so that other slices
    are read meanwhile; the decoder takes one frame at a time. Raises CT-005 (truncated), CT-013
    (unsupported compression), CT-014 (not a CT slice).
    """
    data = read_dicom(header.path)
    name = header.path.name
    for keyword, defect in (("SamplesPerPixel", "has colour"), ("NumberOfFrames", "has several frames")):
        if (count := _read_integer(header, data, keyword, 1)) != 1:
            raise PIXELS_UNUSABLE(f"{name} {defect}", expected=f"{keyword} of 1", got=str(count))
    photometry = read_attribute_text(header.path, data, "PhotometricInterpretation")
    if photometry not in ("", "MONOCHROME2"):
        raise PIXELS_UNUSABLE(f"{name} has photometric interpretation {photometry}")
    if "FloatPixelData" in data or "DoubleFloatPixelData" in data:
        raise PIXELS_UNUSABLE(f"{name} has floating-point pixels", expected="integers")
    if "PixelData" not in data:
        raise FILE_DAMAGED(f"{name} is truncated: its pixel data are missing or cut off")
    syntax = read_attribute_text(header.path, data.file_meta, "TransferSyntaxUID")
    if syntax in _LITTLE_ENDIAN_UNCOMPRESSED and _read_integer(header, data, "BitsAllocated", 0) == 16:
        stored = _decode_16_bit(data, read_value(header.path, data, "PixelData"), header, target.shape)
    else:
        stored = yield from _decode_with_library(data, header, syntax, target.shape, decoder)
    _rescale_into(target, stored, header)


def _read_integer(header: SliceHeader, data: FileDataset, keyword: str, default: int) -> int:
    number = read_optional_number(header.path, data, keyword)
    return default if number is None else int(number)


def _decode_16_bit(
    data: FileDataset, pixels: object, header: SliceHeader, shape: tuple[int, ...]
) -> NDArray[np.integer]:
    name = header.path.name
    representation = _read_integer(header, data, "PixelRepresentation", 0)
    if representation not in (UNSIGNED, SIGNED):
        raise PIXELS_UNUSABLE(f"{name} has pixel representation {representation}", expected="0 or 1")
    needed = 2 * shape[0] * shape[1]
    if not isinstance(pixels, bytes) or len(pixels) < needed:
        got = f"{len(pixels)}" if isinstance(pixels, bytes) else "none"
        raise FILE_DAMAGED(f"{name} is truncated", expected=f"{needed} bytes of pixels", got=got)
    if len(pixels) > needed:
        raise FILE_DAMAGED(
            f"{name} has more pixels than its header says", expected=f"{needed} bytes", got=f"{len(pixels)}"
        )
    kind = "<i2" if representation == SIGNED else "<u2"
    stored = np.frombuffer(pixels, kind, needed // 2).reshape(shape)
    bits = _read_integer(header, data, "BitsStored", 16)
    high = _read_integer(header, data, "HighBit", bits - 1)
    if not 1 <= bits <= high + 1 <= 16:
        raise PIXELS_UNUSABLE(f"{name} stores {bits} bits up to bit {high}")
    if bits == 16:
        return stored
    # bits above the high bit are not part of the value; shifting back extends the sign
    return (stored << (15 - high)) >> (16 - bits)


def _decode_with_library(
    data: FileDataset, header: SliceHeader, stated: str, shape: tuple[int, ...], decoder: FrameDecoder
) -> Generator[None, None, NDArray[np.integer]]:
    from pydicom import config
    from pydicom.encaps import get_frame
    from pydicom.uid import UID

    path, name, syntax = header.path, header.path.name, UID(stated, validation_mode=config.IGNORE)
    try:
        if syntax.is_encapsulated:
            # An Extended Offset Table can lead the decoder to another frame than the one that is checked.
            if "ExtendedOffsetTable" in data:
                raise InputRefused("one frame, with an Extended Offset Table", expected="none")
            frame = get_frame(data.PixelData, 0, number_of_frames=1)
            check_frame(stated, frame, shape, data.BitsAllocated // 8)
            bits = _read_integer(header, data, "BitsStored", 0)
            if stated == JPEG_LS and data.BitsAllocated == 16 and 8 < bits == read_jpeg_bits(frame):
                yield
                decoder.send_jpeg_ls(frame)
                yield
                pixels = decoder.receive().tobytes()
                yield
                return _decode_16_bit(data, pixels, header, shape)
            yield
            yield
            stored = decoder.decode(path)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the header was checked before
                stored = np.asarray(data.pixel_array)
    except InputRefused as problem:
        raise FILE_DAMAGED(f"{name} is refused: {problem.summary}") from problem
    except MemoryError:
        raise
    except Exception as problem:
        if not can_decode(syntax):
            raise COMPRESSION_UNKNOWN(f"{name} is compressed with {syntax.name}") from problem
        sound = isinstance(problem, NotDecoded) and problem.from_outside
        words = f"{name}: its pixel data cannot be decoded ({problem})"
        raise FILE_DAMAGED(words, action=MAY_BE_SOUND if sound else None) from problem
    if stored.shape != shape or stored.dtype.kind not in "iu":
        raise PIXELS_UNUSABLE(f"{name} decodes to shape {stored.shape} of {stored.dtype}")
    return stored


def _rescale_into(target: NDArray[np.int16], stored: NDArray[np.integer], header: SliceHeader) -> None:
    offset = round(header.intercept)
    if header.slope == 1 and header.intercept == offset:
        low, high = int(stored.min()) + offset, int(stored.max()) + offset
        if low >= HU_LIMITS[0] and high <= HU_LIMITS[1] and abs(offset) <= HU_LIMITS[1]:
            # may wrap modulo 2^16 in between, but the result fits and is correct
            np.add(stored.astype(np.int16, copy=False), np.int16(offset), out=target)
            return
    values = stored * header.slope + header.intercept
    np.clip(np.rint(values), *HU_LIMITS, out=values)
    target[...] = values


def _check_intensities(voxels: NDArray[np.int16]) -> tuple[str, ...]:
    darkest = int(voxels.min())
    if darkest <= AIR_BELOW_HU:
        return ()
    return (f"no air in the scan, the darkest voxel has {darkest} HU: these may not be Hounsfield units",)


def _scale_progress(progress: Progress | None, start: float, end: float) -> Progress:
    def report(share: float) -> None:
        if progress is not None:
            progress(start + (end - start) * share)

    return report
