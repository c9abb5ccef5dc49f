"""Tool definitions: the layout of real files, the shipped one, and what is refused."""

import contextlib
import dataclasses
import struct
from datetime import date
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ndi_polaris.errors import BadToolFile, SameGeometry
from drivers.ndi_polaris.geometry import alike_segments_mm, check_distinct, segment_lengths_mm
from drivers.ndi_polaris.options import SHIPPED_DEFINITIONS
from drivers.ndi_polaris.robot_frame import robot_frame
from drivers.ndi_polaris.rom import (
    ToolDefinition,
    decode_definition,
    encode_definition,
    planar_tool,
    read_definition,
)
from sim.polaris.definition import parse_definition, write_definition
from sim.theatre.built_in import robot_frame as robot_frame_of_the_scene

RIGID_BODY = planar_tool(
    "8700339",
    ((0.0, 0.0, 0.0), (28.59, 41.02, 0.0), (0.0, 88.0, 0.0), (-44.32, 40.45, 0.0)),
    manufacturer="NDI",
    made_on=date(2005, 1, 6),
)
RIGID_BODY = dataclasses.replace(RIGID_BODY, sequence=3, minimum_markers=4, maximum_error_mm=0.75)


def test_a_definition_has_the_bytes_of_a_real_one() -> None:
    block = encode_definition(RIGID_BODY)
    assert len(block) == 752
    assert block[:4] == b"NDI\0"
    assert block[6:12] == bytes([0, 0, 1, 0, 0, 0])
    assert block[12] == 0
    assert block[15] == 1
    assert block[20:24] == bytes.fromhex("03148034")
    assert (block[24], block[28], block[32]) == (90, 4, 4)
    assert struct.unpack_from("<f", block, 36) == (0.75,)
    assert struct.unpack_from("<f", block, 64) == (10.0,)
    assert struct.unpack_from("<3f", block, 84) == pytest.approx((28.59, 41.02, 0.0))
    assert block[552:556] == bytes([0, 1, 2, 3])
    assert block[572:577] == bytes([31, 31, 31, 31, 9])
    assert block[580:592] == b"NDI".ljust(12, b"\0")
    assert block[592:612] == b"8700339".ljust(20, b"\0")
    assert block[612:618] == bytes([9, 1, 1, 1, 1, 0])
    assert block[633:638] == bytes([1, 1, 1, 1, 0])
    assert (block[653], block[655]) == (0x80, 0x29)
    assert struct.unpack_from("<3f", block, 656) == (0.0, 0.0, -1.0)
    assert int.from_bytes(block[4:6], "little") == sum(block[6:]) % 65536


def test_what_is_written_is_read_back() -> None:
    back = decode_definition(encode_definition(RIGID_BODY))
    assert back.markers_mm[1] == pytest.approx(RIGID_BODY.markers_mm[1], abs=1e-5)
    assert dataclasses.replace(back, markers_mm=RIGID_BODY.markers_mm) == RIGID_BODY


def test_zero_padding_behind_a_definition_is_allowed() -> None:
    assert decode_definition(encode_definition(RIGID_BODY) + bytes(16)).part_number == "8700339"


def test_the_shipped_robot_frame_is_what_the_generator_writes() -> None:
    shipped = (SHIPPED_DEFINITIONS / "robot_frame.rom").read_bytes()
    assert shipped == encode_definition(robot_frame())


def test_the_robot_frame_is_the_one_that_hangs_in_the_theatre() -> None:
    scene = robot_frame_of_the_scene()
    assert robot_frame().markers_mm == scene.markers_mm
    assert robot_frame().part_number == scene.part_number


def test_the_robot_frame_is_seen_in_one_pose_only() -> None:
    assert alike_segments_mm(robot_frame()) == ()


def test_definitions_written_by_either_side_are_read_alike_by_the_other() -> None:
    theirs = decode_definition(write_definition(robot_frame_of_the_scene()))
    assert theirs.markers_mm == robot_frame().markers_mm
    assert theirs.normals == robot_frame().normals
    ours = parse_definition(encode_definition(robot_frame()))
    assert ours.part_number == "RONNA-M"
    assert ours.markers_mm.tolist() == [list(marker) for marker in robot_frame().markers_mm]


def changed(offset: int, value: int, *, repair: bool = True) -> bytes:
    block = bytearray(encode_definition(RIGID_BODY))
    block[offset] = value
    if repair:
        block[4:6] = (sum(block[6:]) & 0xFFFF).to_bytes(2, "little")
    return bytes(block)


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (b"", "0 bytes"),
        (bytes(752), "not a tool definition"),
        (b"PNG" + bytes(749), "not a tool definition"),
        (encode_definition(RIGID_BODY)[:-1], "751 bytes"),
        (encode_definition(RIGID_BODY) + b"\1", "753 bytes"),
        (changed(100, 7, repair=False), "checksum"),
        (changed(28, 2), "2 markers"),
        (changed(28, 21), "21 markers"),
        (changed(32, 9), "needs 9 of 4"),
        (changed(613, 0), "face"),
        (changed(75, 0x7F), "not finite"),
        (changed(39, 0xBF), "maximum error"),
    ],
)
@pytest.mark.hazard(17)
def test_a_wrong_definition_is_refused_and_says_why(block: bytes, words: str) -> None:
    if words == "not finite":
        block = bytearray(block)
        block[74:76] = b"\xc0\x7f"
        block[4:6] = (sum(block[6:]) & 0xFFFF).to_bytes(2, "little")
    with pytest.raises(BadToolFile, match=words) as caught:
        decode_definition(bytes(block), "tool.rom")
    assert caught.value.code == "NDI-011"


def test_a_missing_definition_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadToolFile, match=r"cannot read gone\.rom"):
        read_definition(tmp_path / "gone.rom")


@pytest.mark.parametrize("part_number", ["x" * 21, "größer"])
def test_a_part_number_that_does_not_fit_is_refused(part_number: str) -> None:
    with pytest.raises(BadToolFile):
        encode_definition(dataclasses.replace(RIGID_BODY, part_number=part_number))


@given(st.binary(min_size=752, max_size=752))
def test_any_block_is_read_or_refused(block: bytes) -> None:
    block = b"NDI\0" + (sum(block[6:]) & 0xFFFF).to_bytes(2, "little") + block[6:]
    with contextlib.suppress(BadToolFile):
        assert isinstance(decode_definition(block), ToolDefinition)


@pytest.mark.hazard(17)
def test_two_tools_with_a_common_triangle_are_refused() -> None:
    mirrored = dataclasses.replace(
        RIGID_BODY, markers_mm=tuple((-x, y + 5.0, z) for x, y, z in RIGID_BODY.markers_mm)
    )
    with pytest.raises(SameGeometry, match="first and second"):
        check_distinct({"first": RIGID_BODY, "second": mirrored})
    check_distinct({"first": RIGID_BODY, "second": robot_frame()})


def test_segments_that_are_alike_are_named() -> None:
    square = planar_tool(
        "SQUARE",
        ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (50.0, 50.0, 0.0), (0.0, 50.0, 0.0)),
        manufacturer="X",
        made_on=date(2025, 1, 1),
    )
    assert len(alike_segments_mm(square)) == 4
    assert segment_lengths_mm(square.markers_mm)[0] == 50.0
