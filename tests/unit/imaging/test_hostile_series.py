"""Malicious DICOM files: a few bytes cost neither memory nor time, and the program survives."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate, get_frame
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    JPEG2000Lossless,
    JPEGLosslessSV1,
    JPEGLSLossless,
    RLELossless,
)
from spoiled_slices import every, setting

from procedures.imaging import errors, read_series
from procedures.imaging.dicom import frame_decoder
from procedures.imaging.dicom.attributes import read_dicom
from procedures.imaging.dicom.frame_decoder import check_frame
from ronna_hw.bounded_input import InputRefused

Write = Callable[..., Path]
FIRST = "0000.dcm"


def stored_as(data: Dataset, syntax: str) -> None:
    data.file_meta.TransferSyntaxUID = syntax


def first(folder: Path) -> Path:
    return folder / FIRST


def test_a_deflated_slice_cannot_expand_without_limit(dicom_series: Write) -> None:
    folder = dicom_series(edit=every(lambda data: stored_as(data, DeflatedExplicitVRLittleEndian)))
    read_series(folder)
    content = first(folder).read_bytes()
    meta = 132 + 12 + struct.unpack_from("<I", content, 140)[0]
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    packed = packer.compress(zlib.decompress(content[meta:], -zlib.MAX_WBITS))
    packed += packer.flush(zlib.Z_FULL_FLUSH)
    zeros = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)  # packed alike at any place
    packed += 3_000 * zeros + packer.flush()
    assert len(packed) < 4_000_000
    first(folder).write_bytes(content[:meta] + packed)
    with bounded_cost(200 << 20), raises(errors.FILE_DAMAGED, match=rf"{FIRST}.*expand beyond the limit"):
        read_series(folder)


def test_an_oversized_file_is_refused_without_reading_it_whole(dicom_series: Write) -> None:
    folder = dicom_series()
    os.truncate(first(folder), 2_000_000_000)  # takes no place on the disk
    with bounded_cost(100 << 20, 1.0), raises(errors.FILE_DAMAGED, match=rf"{FIRST}.*too large"):
        read_series(folder)


@pytest.mark.parametrize("asked", ["dcmread", "Dataset.get", "Dataset.pixel_array"])
def test_memory_that_cannot_be_had_is_no_damage_of_a_file(
    dicom_series: Write, monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    folder = dicom_series(edit=every(lambda data: setattr(data, "BitsAllocated", 8)))  # not read by us alone

    def refuse(*_: object, **_named: object) -> None:
        raise MemoryError

    monkeypatch.setattr(f"pydicom.{asked}", property(refuse) if asked.endswith("array") else refuse)
    with pytest.raises(MemoryError):
        read_series(folder)


SLOW_DECODER = """
import sys, time
from procedures.imaging.dicom import attributes, decoder_process

def work(path):
    begun_s = time.process_time()
    while path.name == "endless" or time.process_time() < begun_s + 0.4:
        pass
    raise ValueError("done")

attributes.read_dicom = work
decoder_process.SLICE_S = 1
decoder_process.main(sys.argv[1:])
"""


def test_each_slice_may_take_its_decoder_some_processor_time_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "slow_decoder.py").write_text(SLOW_DECODER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(frame_decoder, "PROCESS", "slow_decoder")
    before = os.times()
    with frame_decoder.FrameDecoder() as decoder:
        for _ in range(3):
            with pytest.raises(frame_decoder.NotDecoded, match="done"):
                decoder.decode(tmp_path / "slow")
        with pytest.raises(frame_decoder.NotDecoded, match="gave up"):
            decoder.decode(tmp_path / "endless")
    assert os.times().children_user - before.children_user < 15.0


def test_a_decoder_that_takes_no_frame_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "halted_decoder.py").write_text("import signal\nsignal.pause()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(frame_decoder, "PROCESS", "halted_decoder")
    monkeypatch.setattr(frame_decoder, "LIMIT_S", 0.2)
    monkeypatch.setattr(frame_decoder, "END_LIMIT_S", 0.0)
    with frame_decoder.FrameDecoder() as decoder, pytest.raises(frame_decoder.NotDecoded, match="no answer"):
        decoder.send_jpeg_ls(bytes(4 * frame_decoder.PIPE_BYTES))


def test_a_slice_with_too_many_elements_is_refused(dicom_series: Write) -> None:
    folder = dicom_series()
    content = first(folder).read_bytes()
    pixels = content.index(struct.pack("<HH", 0x7FE0, 0x0010))
    empty = b"".join(struct.pack("<HH2sH", 0x0009, number, b"LO", 0) for number in range(0x10, 0x8000))
    first(folder).write_bytes(content[:pixels] + 20 * empty + content[pixels:])
    with bounded_cost(200 << 20, 2.0), raises(errors.FILE_DAMAGED, match=rf"{FIRST}.*too many elements"):
        read_series(folder)


def test_an_overlong_value_is_refused_without_parsing_it(dicom_series: Write) -> None:
    folder = dicom_series()
    content = first(folder).read_bytes()
    spacing = content.index(struct.pack("<HH2s", 0x0028, 0x0030, b"DS"))
    long = struct.pack("<HH2sxxI", 0x0028, 0x0030, b"UN", 4_000_000) + b"1\\" * 2_000_000
    first(folder).write_bytes(content[:spacing] + long + content[spacing + 8 :])
    with bounded_cost(100 << 20, 1.0), raises(errors.FILE_DAMAGED, match=rf"{FIRST}.*too long"):
        read_series(folder)


@pytest.mark.parametrize(
    "absurd",
    [
        {"PixelSpacing": ["1e300", "1e300"]},
        {"PixelSpacing": ["1e-300", "0.5"]},
        {"ImagePositionPatient": ["1e300", "0", "0"]},
        {"Rows": 65535, "Columns": 65535},
    ],
    ids=["huge pixels", "tiny pixels", "far away", "a huge matrix"],
)
def test_sizes_impossible_for_a_scanner_are_refused(dicom_series: Write, absurd: dict[str, object]) -> None:
    folder = dicom_series(edit=every(setting(**absurd)))
    with bounded_cost(100 << 20, 1.0), raises(errors.ATTRIBUTE_MISSING, match=rf"CT-012: {FIRST}"):
        read_series(folder)


def test_a_value_of_very_many_numbers_is_named_in_short(dicom_series: Write) -> None:
    folder = dicom_series(edit=every(setting(PixelSpacing=["1"] * 16_000)))
    with raises(errors.ATTRIBUTE_MISSING, match="PixelSpacing is unusable") as refused:
        read_series(folder)
    assert len(str(refused.value)) < 400


def test_more_pixel_data_than_the_header_declares_is_refused(dicom_series: Write) -> None:
    folder = dicom_series(edit=every(lambda data: setattr(data, "PixelData", data.PixelData + bytes(1000))))
    with raises(errors.FILE_DAMAGED, match=rf"{FIRST} has more pixels than its header says"):
        read_series(folder)


def lossless_jpeg(kind: int, rows: int, columns: int) -> bytes:
    head = struct.pack(">BBHBHHB3s", 0xFF, kind, 11, 16, rows, columns, 1, b"\x01\x11\x00")
    return b"\xff\xd8" + head + b"\xff\xda\x00\x08\x01\x01\x00\x01\x00\x00" + bytes(100) + b"\xff\xd9"


def jpeg_2000(side: int, tile: int) -> bytes:
    size = struct.pack(">HH8IH3B", 41, 0, side, side, 0, 0, tile, tile, 0, 0, 1, 15, 1, 1)
    return b"\xff\x4f\xff\x51" + size + bytes(100)


def runs(count: int) -> bytes:
    return struct.pack("<16I", 2, 64, 64 + 2 * count, *[0] * 13) + b"\x81\0" * (2 * count)


@pytest.mark.parametrize(
    ("syntax", "frame"),
    [
        (JPEGLosslessSV1, lossless_jpeg(0xC3, 60_000, 60_000)),
        (JPEGLSLossless, lossless_jpeg(0xF7, 60_000, 60_000)),  # its decoder ended the whole program
        (JPEG2000Lossless, jpeg_2000(60_000, 60_000)),
        (JPEG2000Lossless, jpeg_2000(7, 1) + bytes(3)),
        (RLELossless, runs(100_000)),
        (RLELossless, b"\0\0"),
        (JPEGLSLossless, b"\xff\xd8\xff"),
    ],
    ids=["JPEG", "JPEG-LS", "JPEG 2000", "another size", "runs", "empty", "cut off"],
)
def test_a_compressed_frame_is_checked_before_it_is_decoded(
    dicom_series: Write, syntax: str, frame: bytes
) -> None:
    def compress(data: Dataset) -> None:
        data.PixelData = encapsulate([frame])
        data["PixelData"].VR = "OB"
        stored_as(data, syntax)

    folder = dicom_series(edit=every(compress))
    with bounded_cost(), raises(errors.FILE_DAMAGED, match=rf"CT-005: {FIRST}"):
        read_series(folder)


def test_a_table_that_leads_the_decoder_to_an_unchecked_frame_is_refused(dicom_series: Write) -> None:
    def compress(data: Dataset) -> None:
        data.compress(RLELossless)
        checked = get_frame(data.PixelData, 0, number_of_frames=1)
        data.PixelData = encapsulate([checked, runs(100_000)], has_bot=False)
        data.ExtendedOffsetTable = struct.pack("<Q", 8 + len(checked))
        data.ExtendedOffsetTableLengths = struct.pack("<Q", len(runs(100_000)))

    folder = dicom_series(edit=every(compress))
    with bounded_cost(), raises(errors.FILE_DAMAGED, match=rf"{FIRST} .*Extended Offset Table"):
        read_series(folder)


def _nowhere(path: Path) -> None:
    path.symlink_to(path.parent / "not mounted yet")


@pytest.mark.parametrize("replace", [_nowhere, os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
@pytest.mark.parametrize("suffix", [".dcm", ""])
def test_a_slice_that_is_there_by_name_only_is_refused(
    dicom_series: Write, replace: Callable[[Path], None], suffix: str
) -> None:
    folder = dicom_series()
    last = max(folder.iterdir())
    last.unlink()
    replace(last.with_suffix(suffix))
    with raises(errors.FILE_DAMAGED, match=f"CT-005: {last.stem}{suffix} is"):
        read_series(folder)


@pytest.mark.parametrize("count", [15, 2**32 - 1])
def test_segments_of_a_frame_that_overlap_are_refused_without_reading_them(count: int) -> None:
    size = 10_000_000
    frame = struct.pack("<16I", count, *[64, size] * 7, 64) + b"\x80" * (size - 64)  # cost seven seconds
    with bounded_cost(limit_s=1.0), pytest.raises(InputRefused, match="segments"):
        check_frame(RLELossless, frame, (512, 512), 2)


def test_attributes_that_were_read_do_not_hold_the_file_of_their_slice(dicom_series: Write) -> None:
    assert read_dicom(first(dicom_series()), only=("Rows", "Columns")).buffer is None


DEADLY_JPEG_2000 = bytes.fromhex(
    "ff4fff510029000000000007000000060000000000000000018f0101ff52000c00000001000104040001ff5c00074080888890"
    "ff64002a000143726561746564206279204744434d2f4f70656e4a5045472076657273690b6e20322e332e30ff90000a000000"
    "0000240001ff93c007d4140ad3183d569a8b3e1567a0003e10c00cbd7fffd9"
)


def test_a_frame_that_crashes_its_decoder_is_refused_and_the_program_survives(dicom_series: Write) -> None:
    pytest.importorskip("gdcm", reason="proof not made: install the extra `compressed`")

    def compress(data: Dataset) -> None:
        data.PixelData = encapsulate([DEADLY_JPEG_2000])
        data["PixelData"].VR = "OB"
        stored_as(data, JPEG2000Lossless)

    folder = dicom_series(edit=every(compress))
    for _ in range(2):
        with raises(errors.FILE_DAMAGED, match=rf"{FIRST}: .*its decoder gave up"):
            read_series(folder)
