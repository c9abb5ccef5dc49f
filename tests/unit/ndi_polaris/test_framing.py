"""Frames and replies, checked against the examples in the protocol reference."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from polaris_mutations import crc_by_definition

from drivers.ndi_polaris.command_link import (
    binary_reply_bytes,
    decode_ascii,
    encode_command,
    split_ascii_line,
    split_binary,
    unit_error,
    warning_meaning,
)
from drivers.ndi_polaris.errors import BadReplyCrc, MalformedReply
from drivers.ndi_polaris.replies import decode_bx, decode_tx
from ronna_hw.wire.polaris import PortStatus, ReplyOption, SystemStatus, crc16

# one tool at (10.50, -20.25, -1500.00), no rotation, error 0.125, frame 300
TX_VALID = "0101+10000+00000+00000+00000+001050-002025-150000+01250000000310000012C\n0000"
TX_MISSING = "0101MISSING000000310000012D\n0000"
BX_VALID = bytes.fromhex(
    "C4A52D00304301"
    "01010000803F0000000000000000000000000000284100"
    "00A2C10080BBC40000003E310000002C01000000001D2D"
)
BX_MISSING = bytes.fromhex("C4A50D002983010102310000002D01000000009E7D")
WITH_STRAYS = ReplyOption.TRANSFORMS | ReplyOption.STRAY_PASSIVE
WITH_INFORMATION = ReplyOption.TRANSFORMS | ReplyOption.TOOL_INFORMATION


def body_of(reply: bytes) -> bytes:
    split = split_binary(reply)
    assert split is not None
    assert split[1] == b""
    return split[0]


@pytest.mark.parametrize(
    ("name", "argument", "line"),
    [
        ("INIT", "", b"INIT:E3A5\r"),
        ("COMM", "50000", b"COMM:500000048\r"),
        ("PHRQ", "*********1****", b"PHRQ:*********1****A4C1\r"),
        ("TSTART", "80", b"TSTART:801B0B\r"),
        ("BX", "1801", b"BX:1801FCED\r"),
    ],
)
def test_commands_carry_the_published_crc(name: str, argument: str, line: bytes) -> None:
    assert encode_command(name, argument) == line


def test_an_ascii_reply_gives_its_text() -> None:
    assert decode_ascii(b"OKAYA896") == "OKAY"
    assert split_ascii_line(b"OKAYA896\rrest") == (b"OKAYA896", b"rest")
    assert split_ascii_line(b"OKAYA8") is None


@pytest.mark.parametrize("line", [b"OKAYA897", b"OKAYa896", b"A896", b"OK", b"", b"OKAZA896"])
def test_an_ascii_reply_with_a_wrong_crc_is_refused(line: bytes) -> None:
    with pytest.raises(BadReplyCrc):
        decode_ascii(line)


def test_error_and_warning_replies_are_recognised() -> None:
    error = unit_error("ERROR0C", "PHSR")
    assert error is not None
    assert error.vendor_code == 0x0C
    assert unit_error("OKAY") is None
    assert warning_meaning("OKAY") is None
    assert "geometry" in (warning_meaning("WARNING02") or "")
    assert warning_meaning("WARNING")
    assert warning_meaning("WARNING77")


def test_a_tx_reply_gives_pose_status_and_frame() -> None:
    assert crc16(TX_VALID.encode()) == 0x361F
    reply = decode_tx(TX_VALID, ReplyOption.TRANSFORMS)
    (report,) = reply.handles
    assert report.handle == 1
    assert report.rotation == (1.0, 0.0, 0.0, 0.0)
    assert report.position_mm == (10.5, -20.25, -1500.0)
    assert report.fit_error_mm == 0.125
    assert report.port_status == PortStatus.OCCUPIED | PortStatus.INITIALISED | PortStatus.ENABLED
    assert report.frame == 300
    assert reply.system_status == SystemStatus(0)


def test_a_tx_reply_keeps_status_and_frame_of_a_missing_tool() -> None:
    assert crc16(TX_MISSING.encode()) == 0xC380
    (report,) = decode_tx(TX_MISSING, ReplyOption.TRANSFORMS).handles
    assert report.frame == 301
    assert report.rotation is None


@pytest.mark.parametrize("word", ["DISABLED", "UNOCCUPIED", "DISABLED0000000100000001"])
def test_a_tx_reply_with_an_absent_handle_is_decoded_with_or_without_status(word: str) -> None:
    (report,) = decode_tx(f"0102{word}\n0000", ReplyOption.TRANSFORMS).handles
    assert (report.handle, report.rotation, report.frame) == (2, None, None)


def test_tx_strays_are_decoded_with_front_padded_outside_bits() -> None:
    strays = "+001000+002000-150000" + "-001000-002000-250000" + "+000000+000000-100000"
    reply = decode_tx(f"0101MISSING000000310000012D\n033{strays}0002", WITH_STRAYS)
    assert reply.strays_mm == ((10, 20, -1500), (-10, -20, -2500), (0, 0, -1000))
    assert reply.stray_outside == (False, True, True)
    assert reply.system_status == SystemStatus.TOO_MUCH_INFRARED


def test_tx_strays_are_decoded_without_outside_bits() -> None:
    text = "0101MISSING000000310000012D\n022+001000+002000-1500000000"
    reply = decode_tx(text, WITH_STRAYS)
    assert reply.strays_mm == ((10, 20, -1500),)
    assert reply.stray_outside is None


def test_a_bx_reply_decodes_to_the_same_as_the_tx_reply_of_the_same_frame() -> None:
    body = body_of(BX_VALID)
    assert binary_reply_bytes(BX_VALID) == len(BX_VALID) == 53
    options = ReplyOption.TRANSFORMS
    assert decode_bx(body, options) == decode_tx(TX_VALID, options)
    assert decode_bx(body_of(BX_MISSING), options) == decode_tx(TX_MISSING, options)


def test_marker_digits_are_read_from_the_first_marker_on_in_text_and_bytes() -> None:
    digits = "3033" + "0" * 16
    (by_text,) = decode_tx(TX_VALID.replace("\n", f"00{digits}\n"), WITH_INFORMATION).handles
    body = body_of(BX_VALID)
    body = body[:-2] + b"\0" + bytes.fromhex(digits[::-1]) + body[-2:]
    (by_bytes,) = decode_bx(body, WITH_INFORMATION).handles
    assert by_text.marker_digits == by_bytes.marker_digits == digits


@pytest.mark.parametrize(("text", "options"), [(TX_VALID, WITH_INFORMATION), (TX_MISSING, WITH_INFORMATION)])
def test_a_record_without_the_marker_digits_that_were_requested_is_refused(
    text: str, options: ReplyOption
) -> None:
    with pytest.raises(MalformedReply, match="does not match the options"):
        decode_tx(text, options)


@pytest.mark.hazard(16)
def test_every_single_bit_error_in_a_binary_reply_is_detected() -> None:
    for position in range(len(BX_VALID)):
        for bit in range(8):
            broken = bytearray(BX_VALID)
            broken[position] ^= 1 << bit
            with pytest.raises((BadReplyCrc, MalformedReply)):
                split_binary(bytes(broken))


def test_a_binary_reply_is_split_off_only_once_it_is_complete() -> None:
    for length in range(len(BX_VALID)):
        assert split_binary(BX_VALID[:length]) is None
    assert split_binary(BX_VALID + b"more") == (body_of(BX_VALID), b"more")


@given(st.binary(max_size=70), st.integers(0, 0xFFFF))
def test_the_crc_matches_its_bit_by_bit_definition(data: bytes, start: int) -> None:
    assert crc16(data, start) == crc_by_definition(data, start)
