"""Tool definitions: parsed and written, each defect named; PINIT refuses bad and warns of ambiguous ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from polaris_bench import Bench, MakeBench

from ronna_hw.wire import polaris_rom as rom
from sim.polaris.unit.refusal import NdiErrorCode
from sim.polaris.unit.tool_definition import BadDefinition, checksum, parse_definition, write_definition
from sim.world.scene.model import TrackerTool
from sim.world.scene.named_scenes import robot_frame

SQUARE = ((0.0, 0.0, 0.0), (80.0, 0.0, 0.0), (80.0, 80.0, 0.0), (0.0, 80.0, 0.0))
TRIANGLE = ((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (70.0, 0.0, 0.0))  # sides 50, 70, 86.0
ONE_SIDE_SHARED = ((0.0, 0.0, 0.0), (0.0, 50.5, 0.0), (110.0, 0.0, 0.0))


def tool(markers: tuple[tuple[float, float, float], ...]) -> TrackerTool:
    return TrackerTool(name="tool", part_number="TOOL", markers_mm=markers)


def changed(content: bytes, offset: int, value: bytes) -> bytes:
    """A definition with some bytes replaced and a right checksum."""
    new = bytearray(content)
    new[offset : offset + len(value)] = value
    struct.pack_into("<H", new, rom.CHECKSUM_OFFSET, checksum(bytes(new)))
    return bytes(new)


def judged(bench: Bench, content: bytes) -> str:
    """Load one more definition; return the reply of PINIT."""
    return bench.send(f"PINIT {bench.load(content):02X}")


def test_equal_segments_break_unique_geometry(bench: Bench) -> None:
    assert judged(bench, write_definition(tool(SQUARE))) == "WARNING02"
    assert bench.send("PHSR 03") == "0101011"  # a warning means that it was carried out


def test_a_triangle_shared_by_two_tools_is_a_conflict(bench: Bench) -> None:
    assert judged(bench, write_definition(tool(TRIANGLE))) == "OKAY"
    assert judged(bench, write_definition(tool((*TRIANGLE, (-40.0, 17.0, 90.0))))) == "WARNING03"
    assert bench.send("PINIT 01") == "WARNING03"


def test_a_freed_tool_no_longer_conflicts(bench: Bench) -> None:
    judged(bench, write_definition(tool(TRIANGLE)))
    bench.send("PHF 01")
    assert judged(bench, write_definition(tool(TRIANGLE))) == "OKAY"


def test_a_tool_can_break_unique_geometry_and_conflict_at_once(bench: Bench) -> None:
    judged(bench, write_definition(tool(SQUARE)))
    assert judged(bench, write_definition(tool(SQUARE))) == "WARNING04"


def test_one_shared_segment_is_a_conflict_if_so_configured(make_bench: MakeBench) -> None:
    for rule, answer in (("triangle", "OKAY"), ("segment", "WARNING03")):
        bench = make_bench(conflict=rule).ready()
        judged(bench, write_definition(tool(TRIANGLE)))
        assert judged(bench, write_definition(tool(ONE_SIDE_SHARED))) == answer


def test_a_unit_can_be_set_to_judge_only_flagged_definitions(make_bench: MakeBench) -> None:
    bench = make_bench(judges_only_flagged=True).ready()
    square = write_definition(tool(SQUARE))
    assert judged(bench, changed(square, rom.FLAGS_OFFSET, b"\0")) == "OKAY"
    assert judged(bench, square) == "WARNING02"


def test_a_tool_without_a_wavelength_gets_the_default_with_a_warning_that_can_be_disabled(
    bench: Bench, pointer: TrackerTool
) -> None:
    content = changed(write_definition(pointer), rom.MARKER_TYPE_OFFSET, b"\0")
    assert judged(bench, content) == "WARNING05"
    assert bench.send("SET Param.Default Wavelength.Return Warning=0") == "OKAY"
    assert bench.send("PINIT 01") == "OKAY"


def test_older_firmware_warns_without_a_code(make_bench: MakeBench) -> None:
    bench = make_bench(warns_with_code=False).ready()
    assert judged(bench, write_definition(tool(SQUARE))) == "WARNING"


def test_a_wavelength_supported_by_no_volume_prevents_tracking(bench: Bench, pointer: TrackerTool) -> None:
    content = changed(write_definition(pointer), rom.MARKER_TYPE_OFFSET, b"\x2f")
    assert judged(bench, content) == "OKAY"
    assert bench.send("TSTART 80") == "OKAY"
    bench.send("TSTOP ")
    bench.send("PENA 01D")
    assert bench.send("TSTART 80") == "ERROR22"


@pytest.mark.parametrize(
    ("offset", "value", "parameter"),
    [
        (0, b"XDI", "bad_definition"),
        (rom.MARKER_COUNT_OFFSET, b"\x15", "definition_beyond_limits"),
        (rom.MARKER_FACES_OFFSET, b"\x09", "definition_beyond_limits"),
        (rom.MARKER_GROUPS_OFFSET, b"\x15", "definition_beyond_limits"),
    ],
)
def test_a_bad_definition_gets_the_error_code_of_the_firmware(
    make_bench: MakeBench, pointer: TrackerTool, offset: int, value: bytes, parameter: str
) -> None:
    content = changed(write_definition(pointer), offset, value)
    old = make_bench()
    new = make_bench(**{parameter: NdiErrorCode.DEFINITION_CORRUPT})
    for bench, answer in ((old, "ERROR13"), (new, "ERROR40")):
        bench.send("INIT ")
        assert judged(bench, content) == answer
        assert bench.send("PHSR 02") == "0101001"


def reference_frame(offset: int, value: bytes) -> bytes:
    """The reference frame's definition with some bytes replaced and a right checksum."""
    return changed(write_definition(robot_frame()), offset, value)


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
    content = reference_frame(rom.SERIAL_OFFSET, bytes.fromhex("03148034"))
    assert parse_definition(content).serial == 0x34801403


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "0 bytes"),
        (reference_frame(0, b"XDI"), "signature NDI is missing"),
        (write_definition(robot_frame())[:-1] + b"\1", "checksum"),
        (reference_frame(rom.MARKER_COUNT_OFFSET, b"\2"), "2 markers"),
        (reference_frame(rom.MARKER_COUNT_OFFSET, b"\x15"), "21 markers"),
        (reference_frame(rom.MINIMUM_MARKER_COUNT_OFFSET, b"\5"), "minimum of 5 of 4"),
        (reference_frame(rom.MAXIMUM_ERROR_OFFSET, struct.pack("<f", float("nan"))), "maximum 3D error"),
        (reference_frame(rom.MARKER_FACES_OFFSET, b"\0"), "face number is not 1 to 8"),
        (reference_frame(rom.MARKER_FACES_OFFSET + 3, b"\x09"), "face number is not 1 to 8"),
        (reference_frame(rom.MARKER_POSITIONS_OFFSET, struct.pack("<f", float("inf"))), "positions"),
        (reference_frame(rom.MARKER_NORMALS_OFFSET, bytes(12)), "normal has length zero"),
    ],
)
def test_each_defect_of_a_definition_is_named(content: bytes, said: str) -> None:
    with pytest.raises(BadDefinition, match=said):
        parse_definition(content)
