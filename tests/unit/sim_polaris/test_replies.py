"""TX and BX replies to the byte, for one tool, a missing tool and strays."""

from __future__ import annotations

import struct

import pytest

from ronna_hw.wire.polaris import PortStatus, ReplyOption, SystemStatus
from sim.polaris.handlers.frame_replies import binary_body, text_reply
from sim.polaris.measurement.frame import MeasuredFrame, Stray
from sim.polaris.measurement.tracking_rules import ToolPose, TrackedTool
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.framing import ascii_reply, binary_reply
from sim.polaris.unit.ports import Port

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
