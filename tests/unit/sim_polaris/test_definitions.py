"""Tool definitions: a written file is read back, and each defect is named."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from ronna_hw.wire import polaris_rom
from sim.polaris.unit.tool_definition import BadDefinition, checksum, parse_definition, write_definition
from sim.world.scene.named_scenes import robot_frame


def changed(offset: int, value: bytes) -> bytes:
    """The reference frame's definition with some bytes replaced and a right checksum."""
    content = bytearray(write_definition(robot_frame()))
    content[offset : offset + len(value)] = value
    struct.pack_into("<H", content, polaris_rom.CHECKSUM_OFFSET, checksum(bytes(content)))
    return bytes(content)


def test_a_written_definition_is_read_back() -> None:
    tool = robot_frame()
    content = write_definition(tool)
    read = parse_definition(content)
    assert len(content) == 752
    assert np.allclose(read.markers_mm, tool.markers_mm)
    assert np.allclose(read.normals, [tool.normal] * 4)
    assert (read.part_number, read.manufacturer, read.main_type) == ("RONNA-M", "RONNA", 1)
    assert (read.minimum_markers, read.maximum_angle_deg, read.maximum_error_mm) == (3, 90.0, 2.0)
    assert read.serial != 0


def test_client_padding_does_not_change_a_definition() -> None:
    content = write_definition(robot_frame())
    for size in (768, 1024, 2048):
        assert parse_definition(content.ljust(size, b"\0")).part_number == "RONNA-M"


def test_the_serial_number_is_read_from_four_little_endian_bytes() -> None:
    content = changed(polaris_rom.SERIAL_OFFSET, bytes.fromhex("03148034"))
    assert parse_definition(content).serial == 0x34801403


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "0 bytes"),
        (changed(0, b"XDI"), "signature NDI is missing"),
        (write_definition(robot_frame())[:-1] + b"\1", "checksum"),
        (changed(polaris_rom.MARKER_COUNT_OFFSET, b"\2"), "2 markers"),
        (changed(polaris_rom.MARKER_COUNT_OFFSET, b"\x15"), "21 markers"),
        (changed(polaris_rom.MINIMUM_MARKER_COUNT_OFFSET, b"\5"), "minimum of 5 of 4"),
        (changed(polaris_rom.MAXIMUM_ERROR_OFFSET, struct.pack("<f", float("nan"))), "maximum 3D error"),
        (changed(polaris_rom.MARKER_FACES_OFFSET, b"\0"), "face number is not 1 to 8"),
        (changed(polaris_rom.MARKER_FACES_OFFSET + 3, b"\x09"), "face number is not 1 to 8"),
        (changed(polaris_rom.MARKER_POSITIONS_OFFSET, struct.pack("<f", float("inf"))), "positions"),
        (changed(polaris_rom.MARKER_NORMALS_OFFSET, bytes(12)), "normal has length zero"),
    ],
)
def test_each_defect_of_a_definition_is_named(content: bytes, said: str) -> None:
    with pytest.raises(BadDefinition, match=said):
        parse_definition(content)
