"""Tool definitions: the layout of real files, the shipped ones, and those that are refused."""

from __future__ import annotations

import dataclasses
import struct
from datetime import date

import numpy as np
import pytest
from coded_errors import raises

from drivers.ndi_polaris.errors import BAD_TOOL_FILE, SAME_GEOMETRY
from drivers.ndi_polaris.shipped_tools import FOLDER, build_shipped_definitions
from drivers.ndi_polaris.tool_comparison import (
    check_distinct,
    compare_definitions,
    find_alike,
    largest_segment_difference_mm,
    segment_lengths_mm,
)
from drivers.ndi_polaris.tool_definition import (
    blank_block,
    decode_definition,
    encode_definition,
    make_planar_tool,
)
from sim.polaris.unit.tool_definition import parse_definition, write_definition
from sim.world.scene.named_scenes import robot_frame

ROBOT_FRAME = build_shipped_definitions()["robot_frame.rom"]
X_FRAME = build_shipped_definitions()["x_frame.rom"]
RIGID_BODY = make_planar_tool(
    "8700339",
    ((0.0, 0.0, 0.0), (28.59, 41.02, 0.0), (0.0, 88.0, 0.0), (-44.32, 40.45, 0.0)),
    manufacturer="NDI",
    made_on=date(2005, 1, 6),
)
RIGID_BODY = dataclasses.replace(RIGID_BODY, sequence=3, minimum_markers=4, maximum_error_mm=0.75)


@pytest.mark.parametrize(
    ("offset", "content"),
    [
        pytest.param(0, b"NDI\0", id="magic"),
        pytest.param(6, bytes([0, 0, 1, 0, 0, 0]), id="constant one"),
        pytest.param(12, bytes([0]), id="subtype"),
        pytest.param(15, bytes([1]), id="main type"),
        pytest.param(20, bytes.fromhex("03148034"), id="serial number"),
        pytest.param(24, bytes([90]), id="largest angle"),
        pytest.param(28, bytes([4]), id="number of markers"),
        pytest.param(32, bytes([4]), id="fewest markers"),
        pytest.param(36, struct.pack("<f", 0.75), id="largest error"),
        pytest.param(64, struct.pack("<f", 10.0), id="constant ten"),
        pytest.param(84, struct.pack("<3f", 28.59, 41.02, 0.0), id="second marker"),
        pytest.param(552, bytes([0, 1, 2, 3]), id="firing sequence"),
        pytest.param(572, bytes([31, 31, 31, 31, 9]), id="no LED, a tool in the port"),
        pytest.param(580, b"NDI".ljust(12, b"\0"), id="manufacturer"),
        pytest.param(592, b"8700339".ljust(20, b"\0"), id="part number"),
        pytest.param(612, bytes([9, 1, 1, 1, 1, 0]), id="constant nine, faces of the markers"),
        pytest.param(633, bytes([1, 1, 1, 1, 0]), id="groups of the markers"),
        pytest.param(653, bytes([0x80]), id="flags"),
        pytest.param(655, bytes([0x29]), id="marker type"),
        pytest.param(656, struct.pack("<3f", 0.0, 0.0, -1.0), id="normal of the face"),
    ],
)
def test_each_field_is_at_the_offset_of_a_real_file(offset: int, content: bytes) -> None:
    block = encode_definition(RIGID_BODY)
    assert block[offset : offset + len(content)] == content


def test_a_definition_is_752_bytes_with_a_checksum_over_those_after_it() -> None:
    block = encode_definition(RIGID_BODY)
    assert len(block) == 752
    assert int.from_bytes(block[4:6], "little") == sum(block[6:]) % 65536


def test_a_definition_survives_writing_and_reading() -> None:
    back = decode_definition(encode_definition(RIGID_BODY))
    assert back.markers_mm[1] == pytest.approx(RIGID_BODY.markers_mm[1], abs=1e-5)
    assert dataclasses.replace(back, markers_mm=RIGID_BODY.markers_mm) == RIGID_BODY


def test_zero_padding_after_a_definition_is_allowed() -> None:
    assert decode_definition(encode_definition(RIGID_BODY) + bytes(16)).part_number == "8700339"


@pytest.mark.parametrize("name", ["robot_frame.rom", "x_frame.rom", "patient_frame.rom"])
def test_a_shipped_definition_matches_the_generator(name: str) -> None:
    assert (FOLDER / name).read_bytes() == encode_definition(build_shipped_definitions()[name])


def test_only_generated_definitions_are_shipped() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(build_shipped_definitions())


def test_the_robot_frame_matches_the_one_in_the_simulated_scene() -> None:
    scene = robot_frame()
    assert ROBOT_FRAME.markers_mm == scene.markers_mm
    assert ROBOT_FRAME.part_number == scene.part_number


def test_the_x_frame_is_two_crossing_bars_with_distances_at_least_8_mm_apart() -> None:
    first, second, third, fourth = (np.array(marker) for marker in X_FRAME.markers_mm)
    crossing = np.zeros(3)
    for end, other in ((first, third), (second, fourth)):
        assert np.dot(end - crossing, other - crossing) < 0  # on either side of the crossing
        sine = np.linalg.norm(np.cross(end, other)) / np.linalg.norm(end) / np.linalg.norm(other)
        assert sine < 0.01
    assert find_alike({"x": X_FRAME}, 8.0) == ()
    both = find_alike({"x": X_FRAME, "M": ROBOT_FRAME}, 5.0)
    assert [pair for pair in both if pair.first_tool != pair.second_tool] == []


def test_no_two_shipped_tools_share_a_triangle_of_markers() -> None:
    shipped = build_shipped_definitions()
    check_distinct(shipped)
    assert find_alike({"patient": shipped["patient_frame.rom"]}, 6.0) == ()
    again = {**shipped, "patient": shipped["robot_frame.rom"]}
    with raises(SAME_GEOMETRY, match=r"NDI-012: tools robot_frame.rom and patient share a triangle"):
        check_distinct(again)


def test_driver_and_simulator_read_each_others_definitions_alike() -> None:
    theirs = decode_definition(write_definition(robot_frame()))
    assert theirs.markers_mm == ROBOT_FRAME.markers_mm
    assert theirs.normals == ROBOT_FRAME.normals
    ours = parse_definition(encode_definition(ROBOT_FRAME))
    assert ours.part_number == "RONNA-M"
    assert ours.markers_mm.tolist() == [list(marker) for marker in ROBOT_FRAME.markers_mm]


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
        (changed(32, 9), "minimum of 9 of 4"),
        (changed(613, 0), "face"),
        (changed(75, 0x7F), "not finite"),
        (changed(39, 0xBF), "maximum error"),
    ],
)
@pytest.mark.hazard(17)
def test_an_invalid_definition_is_refused_with_the_reason(block: bytes, words: str) -> None:
    if words == "not finite":
        block = bytearray(block)
        block[74:76] = b"\xc0\x7f"
        block[4:6] = (sum(block[6:]) & 0xFFFF).to_bytes(2, "little")
    with raises(BAD_TOOL_FILE, match=words) as caught:
        decode_definition(bytes(block), "tool.rom")
    assert caught.value.code == "NDI-011"


@pytest.mark.parametrize("part_number", ["x" * 21, "größer"])
def test_a_part_number_that_does_not_fit_is_refused(part_number: str) -> None:
    with raises(BAD_TOOL_FILE):
        encode_definition(dataclasses.replace(RIGID_BODY, part_number=part_number))


def foreign(seed: int) -> bytes:
    """Return a definition as another maker writes it: every byte that we do not need is noise."""
    block = bytearray(np.random.default_rng(seed).integers(0, 256, 752, dtype=np.uint8).tobytes())
    for offset, size in ((0, 4), (24, 1), (28, 1), (32, 1), (36, 4), (40, 12), (72, 48), (312, 48), (613, 4)):
        block[offset : offset + size] = encode_definition(RIGID_BODY)[offset : offset + size]
    block[656:668] = struct.pack("<3f", 0.0, 0.0, -1.0)
    block[580:592] = b"NDI\0\xff rest\0x"
    block[592:612] = b" padded \0" + bytes(11)
    block[4:6] = (sum(block[6:]) & 0xFFFF).to_bytes(2, "little")
    return bytes(block)


@pytest.mark.parametrize("seed", range(20))
def test_bytes_outside_all_known_fields_survive_a_round_trip(seed: int) -> None:
    block = foreign(seed)
    assert encode_definition(decode_definition(block)) == block


def test_a_change_to_a_foreign_definition_alters_no_other_bytes() -> None:
    block = foreign(3)
    changed_error = dataclasses.replace(decode_definition(block), maximum_error_mm=2.0)
    written = encode_definition(changed_error)
    differing = {at for at in range(752) if written[at] != block[at]}
    assert differing <= {4, 5, *range(36, 40)}
    assert decode_definition(written).maximum_error_mm == 2.0


def test_removing_a_marker_leaves_no_trace_of_it() -> None:
    three = dataclasses.replace(
        decode_definition(encode_definition(RIGID_BODY)),
        markers_mm=RIGID_BODY.markers_mm[:3],
        normals=RIGID_BODY.normals[:3],
        faces=(1, 1, 1),
        minimum_markers=3,
    )
    fresh = dataclasses.replace(three, origin=blank_block())
    assert encode_definition(three) == encode_definition(fresh)
    assert encode_definition(three)[72 + 36 : 72 + 48] == bytes(12)


def test_a_comparison_names_each_difference_and_how_far_a_marker_moved() -> None:
    moved = dataclasses.replace(
        RIGID_BODY,
        part_number="8700340",
        markers_mm=(*RIGID_BODY.markers_mm[:3], (-44.32, 40.45, 4.0)),
        made_on=date(2006, 1, 6),
    )
    found = {d.field: d for d in compare_definitions(RIGID_BODY, moved)}
    assert set(found) == {"part_number", "markers_mm[4]", "made_on"}
    assert found["markers_mm[4]"].distance_mm == pytest.approx(4.0)
    assert (found["part_number"].first, found["part_number"].second) == ("8700339", "8700340")
    assert compare_definitions(RIGID_BODY, RIGID_BODY) == ()


def test_a_comparison_shows_differing_bytes_outside_all_known_fields() -> None:
    block = bytearray(encode_definition(RIGID_BODY))
    block[60], block[61], block[654] = 0xAB, 0xCD, 0x01
    block[4:6] = (sum(block[6:]) & 0xFFFF).to_bytes(2, "little")
    found = compare_definitions(RIGID_BODY, decode_definition(bytes(block)))
    assert [(d.field, d.first, d.second) for d in found] == [
        ("bytes 60 to 61", "00 00", "ab cd"),
        ("byte 654", "00", "01"),
    ]


def test_the_same_shape_at_another_pose_is_recognised_by_its_distances() -> None:
    elsewhere = dataclasses.replace(
        RIGID_BODY, markers_mm=tuple((y + 10.0, -x, z + 5.0) for x, y, z in RIGID_BODY.markers_mm)
    )
    assert compare_definitions(RIGID_BODY, elsewhere)
    assert largest_segment_difference_mm(RIGID_BODY, elsewhere) == pytest.approx(0.0, abs=1e-9)
    assert largest_segment_difference_mm(RIGID_BODY, ROBOT_FRAME) > 5.0


@pytest.mark.hazard(17)
def test_two_tools_that_share_a_triangle_are_refused() -> None:
    mirrored = dataclasses.replace(
        RIGID_BODY, markers_mm=tuple((-x, y + 5.0, z) for x, y, z in RIGID_BODY.markers_mm)
    )
    with raises(SAME_GEOMETRY, match="first and second"):
        check_distinct({"first": RIGID_BODY, "second": mirrored})
    check_distinct({"first": RIGID_BODY, "second": ROBOT_FRAME})


def test_similar_segments_of_a_tool_are_found() -> None:
    square = make_planar_tool(
        "SQUARE",
        ((0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (50.0, 50.0, 0.0), (0.0, 50.0, 0.0)),
        manufacturer="X",
        made_on=date(2025, 1, 1),
    )
    assert len(find_alike({"square": square})) == 4
    assert segment_lengths_mm(square.markers_mm)[0] == 50.0
