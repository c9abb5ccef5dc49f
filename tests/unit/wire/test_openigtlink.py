"""OpenIGTLink: its layout against bytes written by hand, its check sum as published, and its bounds."""

from __future__ import annotations

import random
import struct

import numpy as np
import psutil
import pytest
from igtl_streams import POSE, SEEDS, TOOL, read_all, spoilt_streams

from ronna_hw.wire.crc64 import LANE_BYTES, SHORT_BYTES, crc64
from ronna_hw.wire.openigtlink import (
    HEADER_BYTES,
    LARGEST_BODY_BYTES,
    MessageReader,
    StreamBroken,
    encode_message,
)
from ronna_hw.wire.openigtlink_contents import (
    CoordinateSystem,
    Malformed,
    ScalarType,
    Status,
    decode_quaternion_tracking,
    decode_tracking,
    decode_transform,
    encode_image,
    encode_quaternion_tracking,
    encode_status,
    encode_tracking,
    encode_transform,
)

PUBLISHED_CHECK = 0x6C40DF5F0B497347  # of CRC-64/ECMA-182, over the digits 1 to 9
BY_COLUMNS = (0, 1, 0, -1, 0, 0, 0, 0, 1, 10, 20, 30)  # of POSE: a transposed rotation has -1 first
GROWTH_LIMIT_BYTES = 8 << 20  # of the whole process; a body that is kept has up to 1 MiB


def test_the_check_sum_is_the_published_one() -> None:
    assert crc64(b"123456789") == PUBLISHED_CHECK
    assert crc64(b"") == 0


@pytest.mark.parametrize("size", [SHORT_BYTES + 1, 33 * LANE_BYTES, 33 * LANE_BYTES + 1, 20_001])
def test_lanes_have_the_check_sum_of_a_division_bit_by_bit(size: int) -> None:
    data = random.Random(size).randbytes(size)
    polynomial, value = 0x142F0E1EBA9EA3693, int.from_bytes(data, "big") << 64
    for bit in range(value.bit_length() - 1, 63, -1):
        if value >> bit & 1:
            value ^= polynomial << (bit - 64)
    assert crc64(data) == value


def test_a_transform_has_the_bytes_of_the_document() -> None:
    sent = encode_message("TRANSFORM", "ToolToRas", encode_transform(POSE), 1_500_000_000)
    body = struct.pack(">12f", *BY_COLUMNS)
    assert sent[:2] == b"\0\1"
    assert sent[2:14] == b"TRANSFORM\0\0\0"
    assert sent[14:34] == b"ToolToRas".ljust(20, b"\0")
    assert sent[34:42] == b"\0\0\0\1\x80\0\0\0"
    assert sent[42:] == struct.pack(">QQ", 48, crc64(body)) + body


def test_version_two_wraps_the_content_in_sizes_and_metadata() -> None:
    sent = encode_message(
        "STRING", "S", b"content", version=2, metadata={"ab": "xyz", "c": "µ"}, message_id=5
    )
    entries = b"\0\2" + struct.pack(">HHI", 2, 3, 3) + struct.pack(">HHI", 1, 106, 2)
    wrapped = struct.pack(">HHII", 12, 18, 8, 5) + b"content" + entries + b"abxyzc\xc2\xb5"
    assert sent[HEADER_BYTES:] == wrapped
    (message,) = MessageReader().feed(sent)
    assert (message.content, message.metadata, message.message_id) == (b"content", {"ab": "xyz", "c": "µ"}, 5)


def test_a_name_over_twenty_bytes_is_refused() -> None:
    with pytest.raises(ValueError, match="20 bytes"):
        encode_message("TRANSFORM", "A" * 21)


def test_a_stamp_keeps_its_nanoseconds() -> None:
    (message,) = MessageReader().feed(encode_message("STRING", "S", stamp_ns=1_700_000_000_123_456_789))
    assert message.stamp_ns == 1_700_000_000_123_456_789


def test_a_status_ends_with_a_zero_byte() -> None:
    assert encode_status(Status(13, "wait", "NotReady", 7)) == (
        b"\0\x0d" + bytes(7) + b"\7" + b"NotReady".ljust(20, b"\0") + b"wait\0"
    )


def test_tracking_data_are_the_same_pose_by_matrix_and_by_quaternion() -> None:
    by_matrix, by_quaternion = encode_tracking([TOOL]), encode_quaternion_tracking([TOOL])
    assert struct.unpack(">20sBB12f", by_matrix)[1:] == (2, 0, *BY_COLUMNS)
    half = np.sqrt(0.5)
    assert struct.unpack(">20sBB7f", by_quaternion)[3:] == pytest.approx((10, 20, 30, 0, 0, half, half))
    for decoded in (decode_tracking(by_matrix), decode_quaternion_tracking(by_quaternion)):
        assert decoded[0].name == TOOL.name
        assert decoded[0].pose == pytest.approx(POSE, abs=1e-6)


def test_an_image_states_its_centre() -> None:
    placement = np.diag([0.5, 0.5, 2.0, 1.0])
    placement[:3, 3] = (-10.0, -20.0, 5.0)
    content = encode_image((3, 5, 2), bytes(60), ScalarType.INT16, placement, CoordinateSystem.LPS)
    fields = struct.unpack(">HBBBB3H12f6H", content[:72])
    assert fields[:8] == (1, 1, 4, 2, 2, 3, 5, 2)
    assert fields[8:20] == (0.5, 0, 0, 0, 0.5, 0, 0, 0, 2, -9.5, -19, 6)
    assert fields[20:] == (0, 0, 0, 3, 5, 2)


def test_numbers_that_are_not_finite_are_no_pose() -> None:
    with pytest.raises(Malformed, match="finite"):
        decode_transform(struct.pack(">12f", float("nan"), *BY_COLUMNS[1:]))


def test_a_stream_in_single_bytes_gives_the_same_messages() -> None:
    reader, stream = MessageReader(), b"".join(SEEDS)
    single = [message for byte in stream for message in reader.feed(bytes([byte]))]
    assert single == list(MessageReader().feed(stream))
    assert len(single) == len(SEEDS)


def test_a_wrong_check_sum_spoils_only_its_message() -> None:
    spoilt = bytearray(SEEDS[0])
    spoilt[-1] ^= 1
    first, second = MessageReader().feed(bytes(spoilt) + SEEDS[1])
    assert (first.fault, first.content) == ("wrong check sum", b"")
    assert second.fault == ""


@pytest.mark.parametrize(
    ("version", "size", "reason"),
    [(0x4745, 0, "version 18245"), (1, LARGEST_BODY_BYTES + 1, "1048577 bytes")],
)
def test_an_impossible_header_breaks_the_stream(version: int, size: int, reason: str) -> None:
    header = struct.pack(">H12s20sIIQQ", version, b"STRING", b"S", 0, 0, size, 0)
    with pytest.raises(StreamBroken, match=reason):
        list(MessageReader().feed(header))


@pytest.mark.parametrize(
    ("count", "seed"),
    [(1_000, 1), pytest.param(1_000_000, 2, marks=[pytest.mark.soak, pytest.mark.timeout(600)])],
)
def test_spoilt_streams_neither_crash_the_reader_nor_grow_it(count: int, seed: int) -> None:
    process, usable = psutil.Process(), 0
    for number, stream in enumerate(spoilt_streams(count, seed)):
        usable += read_all(stream, LARGEST_BODY_BYTES)
        if number == count // 10:
            settled_bytes = process.memory_info().rss
    assert process.memory_info().rss - settled_bytes < GROWTH_LIMIT_BYTES
    assert usable > count / 5  # contents were read, not only headers refused
