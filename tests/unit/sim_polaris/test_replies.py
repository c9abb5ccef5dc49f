"""Replies to the byte, for one tool, a missing tool and strays; command lines out of a stream, and CRCs."""

from __future__ import annotations

import struct

import pytest

from ronna_hw.wire.polaris import PortStatus, ReplyOption, SystemStatus
from sim.polaris.handlers.frame_replies import binary_body, text_reply
from sim.polaris.measurement.frame import MeasuredFrame, Stray
from sim.polaris.measurement.tracking_rules import ToolPose, TrackedTool
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.framing import LineBuffer, Overlong, ascii_reply, binary_reply, parse_request
from sim.polaris.unit.ports import Port
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode

T = ReplyOption.TRANSFORMS
PORT = Port(0x01, initialised=True, enabled=True)
POSE = ToolPose((1.0, 0.0, 0.0, 0.0), (10.5, -20.25, -1500.0), 0.125)
INSIDE = PortStatus(0)
NO_FAULT = SystemStatus(0)
USUAL = UnitBehaviour()


def frame_with(number: int, tracked: TrackedTool | None, *strays: Stray) -> MeasuredFrame:
    return MeasuredFrame(number, ((PORT, tracked),), strays, NO_FAULT)


def valid(volume_status: PortStatus = INSIDE) -> TrackedTool:
    return TrackedTool(POSE, volume_status, 0x10, (3, 3, 0, 3))


def missing() -> TrackedTool:
    return TrackedTool(None, INSIDE, 0x02, (0, 0, 0, 0))


def test_a_visible_tool_is_encoded_as_in_the_published_example() -> None:
    frame = frame_with(300, valid())
    text = b"0101+10000+00000+00000+00000+001050-002025-150000+01250000000310000012C\n0000361F\r"
    assert ascii_reply(text_reply(frame, T, USUAL)) == text
    body = (
        "01 0101 0000803F 00000000 00000000 00000000 00002841 0000A2C1 0080BBC4 0000003E"
        "31000000 2C010000 0000"
    )
    assert binary_reply(binary_body(frame, T, USUAL)) == bytes.fromhex("C4A5 2D00 3043" + body + "1D2D")


def test_a_missing_tool_keeps_its_status_and_frame() -> None:
    frame = frame_with(301, missing())
    assert ascii_reply(text_reply(frame, T, USUAL)) == b"0101MISSING000000310000012D\n0000C380\r"
    reply = bytes.fromhex("C4A5 0D00 2983 01 0102 31000000 2D010000 0000 9E7D")
    assert binary_reply(binary_body(frame, T, USUAL)) == reply


def test_marker_digits_are_in_the_order_of_the_profile() -> None:
    frame = frame_with(1, valid())
    text = text_reply(frame, ReplyOption.TOOL_INFORMATION, USUAL)
    assert text == "0101" + "10" + "3303" + "0" * 16 + "\n0000"
    body = binary_body(frame, ReplyOption.TOOL_INFORMATION, USUAL)
    assert body[3:14] == bytes([0x10, *[0] * 8, 0x30, 0x33])


def test_all_strays_are_counted_but_those_outside_are_reported_only_on_request() -> None:
    strays = (Stray((1.0, 2.0, -1000.0), True), Stray((900.0, 0.0, -1000.0), False))
    frame = MeasuredFrame(1, (), strays, NO_FAULT)
    alone = ReplyOption.STRAY_PASSIVE
    every = alone | ReplyOption.OUT_OF_VOLUME
    assert text_reply(frame, alone, USUAL) == "00" + "021" + "+000100+000200-100000" + "0000"
    said = "+000100+000200-100000+090000+000000-100000"
    assert text_reply(frame, every, USUAL) == "00" + "021" + said + "0000"
    assert binary_body(frame, alone, USUAL) == b"\0\2\2" + struct.pack("<3f", 1, 2, -1000) + b"\0\0"
    assert len(binary_body(frame, every, USUAL)) == 3 + 24 + 2


@pytest.mark.parametrize(("count", "digits", "flag_bytes"), [(0, 0, 0), (1, 1, 1), (4, 1, 1), (9, 3, 2)])
def test_out_of_volume_bits_take_as_many_digits_as_strays_need(
    count: int, digits: int, flag_bytes: int
) -> None:
    frame = MeasuredFrame(1, (), (Stray((0.0, 0.0, -1500.0), True),) * count, NO_FAULT)
    option = ReplyOption.STRAY_PASSIVE
    assert len(text_reply(frame, option, USUAL)) == 2 + 2 + digits + 21 * count + 4
    assert len(binary_body(frame, option, USUAL)) == 1 + 1 + flag_bytes + 12 * count + 2


LIMIT = 40


@pytest.mark.parametrize(
    ("line", "name", "argument"),
    [
        (b"INIT:E3A5", "INIT", ""),
        (b"INIT ", "INIT", ""),
        (b"INIT", "INIT", ""),
        (b"TX:1801" + b"3D9A", "TX", "1801"),
        (b"TX 1801", "TX", "1801"),
        (b"PHSR:0020ff", "PHSR", "00"),
        (b"SET Param.User.String0=a:b c", "SET", "Param.User.String0=a:b c"),
        (b"\nTSTOP ", "TSTOP", ""),
    ],
)
def test_all_three_forms_of_a_command_are_read(line: bytes, name: str, argument: str) -> None:
    request = parse_request(line)
    assert (request.name, request.argument) == (name, argument)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"INIT:E3A6", NdiErrorCode.WRONG_CRC),
        (b"INIT:+3A5", NdiErrorCode.WRONG_CRC),
        (b"INIT:E3", NdiErrorCode.TOO_SHORT),
        (b"", NdiErrorCode.TOO_SHORT),
        (Overlong(b"ECHO"), NdiErrorCode.TOO_LONG),
    ],
)
def test_a_malformed_line_is_refused_with_its_own_code(line: bytes, code: NdiErrorCode) -> None:
    with pytest.raises(CommandRefusal) as refused:
        parse_request(line)
    assert refused.value.code is code


def test_an_answer_carries_its_crc_high_byte_first() -> None:
    assert ascii_reply("OKAY") == b"OKAYA896\r"
    assert ascii_reply("RESET") == b"RESETBE6F\r"
    assert ascii_reply("ERROR01") == b"ERROR016BC2\r"


def test_a_binary_answer_ends_with_its_crc() -> None:
    body = bytes.fromhex("01 0102 31000000 2D010000 0000")
    assert binary_reply(body) == bytes.fromhex("C4A5 0D00 2983") + body + bytes.fromhex("9E7D")


def test_commands_may_arrive_byte_by_byte_or_several_at_once() -> None:
    buffer = LineBuffer(LIMIT)
    assert [buffer.feed(b"%c" % byte, 0.0) for byte in b"INIT \r"] == [[], [], [], [], [], [b"INIT "]]
    assert buffer.feed(b"TSTOP \rVER 0\rTX", 0.1) == [b"TSTOP ", b"VER 0"]
    assert buffer.feed(b" 0001\r", 0.2) == [b"TX 0001"]


def test_a_half_sent_command_is_dropped_after_a_pause() -> None:
    buffer = LineBuffer(LIMIT)
    assert buffer.feed(b"PVWR 0100", 0.0) == []
    assert buffer.feed(b"INIT \r", 5.0) == [b"INIT "]


def test_an_overlong_line_is_cut_and_the_next_one_is_intact() -> None:
    buffer = LineBuffer(LIMIT)
    for _ in range(10):
        assert buffer.feed(b"x" * 30, 0.0) == []
    first, second = buffer.feed(b"xxx\rINIT \r", 0.0)
    assert isinstance(first, Overlong)
    assert second == b"INIT "
