"""Wired tools: sockets, handles, memory and lights; passive tools are refused the same commands."""

from __future__ import annotations

from pathlib import Path

import pytest
from coded_errors import raises
from polaris_bench import Bench, MakeBench

from ronna_hw.wire import polaris_rom as rom
from sim.polaris.errors import BAD_WIRED_TOOL
from sim.polaris.unit.ports import WiredPorts, WiredTool, plug_in
from sim.polaris.unit.tool_definition import checksum, write_definition
from sim.world.scene.model import TrackerTool

SOCKETS = 3
USER_BYTES = 1024
BLOCK = "5A" * 64
ANY_PASSIVE = "PHRQ *********1****"


def wired_definition(tool: TrackerTool) -> bytes:
    """Definition of a wired tool with a switch, two visible LEDs and a tool-in-port diode."""
    content = bytearray(write_definition(tool))
    content[rom.LEDS_OFFSET : rom.LEDS_OFFSET + 4] = bytes([rom.LED_NONE, 0, 1, rom.LED_NONE])
    content[rom.TOOL_IN_PORT_OFFSET : rom.TOOL_IN_PORT_OFFSET + 4] = bytes([9, 9, 8, 8])
    content[rom.CHECKSUM_OFFSET : rom.CHECKSUM_OFFSET + 2] = checksum(bytes(content)).to_bytes(2, "little")
    return bytes(content)


@pytest.fixture
def two_wired(make_bench: MakeBench, pointer: TrackerTool) -> Bench:
    """A unit with two wired tools in three sockets; the second has no memory."""
    sockets = WiredPorts(SOCKETS)
    sockets.add(WiredTool.from_definition(wired_definition(pointer), 1, USER_BYTES))
    sockets.add(WiredTool(None, bytearray(USER_BYTES)))
    return make_bench(wired=sockets).ready()


def test_plugged_tools_have_handles_after_init(two_wired: Bench) -> None:
    assert two_wired.send("PHSR 02") == "0201001" + "02001"
    assert two_wired.send(ANY_PASSIVE) == "03"
    assert two_wired.send("PHINF 010020") == "P7-00042" + "00" + "01" + "00"
    assert two_wired.send("VER 3").startswith("Polaris Spectra System Control Unit")
    assert two_wired.send("SFLIST 01") == "3"
    assert two_wired.send("SFLIST 00") == "0000001F"


def test_a_socket_has_one_handle(two_wired: Bench) -> None:
    assert two_wired.send("PHRQ *********001**") == "ERROR30"
    assert two_wired.send("PHF 01") == "OKAY"
    assert two_wired.send("PHRQ *********001**") == "01"
    assert two_wired.send("PHRQ *********0****") == "03"
    assert two_wired.send("PHRQ *********0****") == "ERROR30"
    assert two_wired.send("PHRQ *********004**") == "ERROR2F"


def test_an_empty_socket_gets_a_handle_without_a_tool_or_with_a_dummy(two_wired: Bench) -> None:
    assert two_wired.send("PHRQ *********003**") == "03"
    assert two_wired.send("PHSR 00").endswith("03000")
    assert two_wired.send("PHINF 030001") == "UNOCCUPIED"
    assert two_wired.send("PINIT 03") == "ERROR0D"
    two_wired.send("PHF 03")
    assert two_wired.send("PHRQ *********00301") == "03"
    assert two_wired.send("PINIT 03") == "OKAY"


def test_a_wired_tool_is_initialised_from_its_own_memory(two_wired: Bench) -> None:
    assert two_wired.send("PINIT 01") == "OKAY"
    assert two_wired.send("PENA 01D") == "OKAY"
    assert two_wired.send("PHINF 01")[:8] == "01" + "12" + "00" + "00"  # one switch, two lights
    assert two_wired.send("PHINF 010008") == f"{0x01 | 0x02 | 0x20 | 0x40:02X}"
    assert two_wired.send("TSTART 80") == "OKAY"
    answer = two_wired.send("TX 1801")
    assert answer.startswith("0101+")
    assert answer.split("\n")[1] == "00" + "0000"  # the illuminators rest: no strays


def test_ttcfg_gives_a_tool_without_memory_a_test_definition(two_wired: Bench) -> None:
    assert two_wired.send("PINIT 02") == "ERROR0D"
    assert two_wired.send("PPRD 020000") == "ERROR1E"
    assert two_wired.send("PPWR 020000" + BLOCK) == "ERROR1F"
    assert two_wired.send("PSRCH 02") == "0"
    assert two_wired.send("TTCFG 02") == "OKAY"
    assert two_wired.send("PINIT 02") == "OKAY"
    assert two_wired.send("TTCFG 01") == "ERROR32"  # it has a definition of its own


def test_phinf_reports_the_current_test(two_wired: Bench) -> None:
    assert two_wired.send("TCTST 01") == "ERROR0E"
    two_wired.send("PINIT 01")
    assert two_wired.send("PHINF 010002") == "00000000"
    assert two_wired.send("TCTST 01") == "OKAY"
    assert two_wired.send("PHINF 010002") == "0000000F"


def test_memory_is_read_and_written_in_blocks(two_wired: Bench, pointer: TrackerTool) -> None:
    assert two_wired.send("PPRD 010000") == wired_definition(pointer)[:64].hex().upper()
    assert two_wired.send("PPWR 0107C0" + BLOCK) == "OKAY"
    assert two_wired.send("PPRD 0107C0") == BLOCK
    assert two_wired.send("PURD 010000") == "00" * 64
    assert two_wired.send("PUWR 0103C0" + BLOCK) == "OKAY"
    assert two_wired.send("PURD 0103C0") == BLOCK
    assert two_wired.send("PURD 010400") == "ERROR23"
    assert two_wired.send("PPRD 010001") == "ERROR23"
    assert two_wired.send("PPRD 01000") == "ERROR07"
    assert two_wired.send("INIT ") == "OKAY"
    assert two_wired.send("PPRD 0107C0") == BLOCK  # it stays in the tool


def test_a_memory_device_is_found_and_selected(two_wired: Bench) -> None:
    found = two_wired.send("PSRCH 01")
    assert found == "1" + "1".zfill(16)
    assert two_wired.send("PSEL 01" + found[1:]) == "OKAY"
    assert two_wired.send("PSEL 01" + "F" * 16) == "ERROR20"
    assert two_wired.send("PSEL 01") == "ERROR07"


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("LED 011S", "OKAY"),
        ("LED 014S", "ERROR0A"),
        ("LED 011X", "ERROR0B"),
        ("LED 011", "ERROR07"),
        ("LED 021S", "ERROR0E"),
        ("LED 091S", "ERROR2B"),
        ("PSOUT 01NSP", "OKAY"),
        ("PSOUT 01NSX", "ERROR23"),
        ("PSOUT 01N", "ERROR07"),
    ],
)
def test_lights_and_outputs_are_set_in_setup_and_while_tracking(
    two_wired: Bench, line: str, answer: str
) -> None:
    two_wired.send("PINIT 01")
    assert two_wired.send(line) == answer
    two_wired.send("TSTART ")
    assert two_wired.send(line) == answer  # while tracking too


@pytest.mark.parametrize(
    "line",
    [
        "PPRD 030000", "PPWR 030000" + BLOCK, "PURD 030000", "PUWR 030000" + BLOCK, "PSRCH 03",
        "PSEL 03" + "0" * 16, "TTCFG 03", "TCTST 03", "LED 031S", "PSOUT 03NNN",
    ],
)  # fmt: skip
def test_wired_tool_commands_are_refused_for_a_passive_tool(two_wired: Bench, line: str) -> None:
    two_wired.send(ANY_PASSIVE)
    assert two_wired.send(line) == "ERROR32"


def test_a_tool_unplugged_while_tracking_is_reported_unoccupied(two_wired: Bench) -> None:
    two_wired.send("PINIT 01")
    two_wired.send("PENA 01D")
    two_wired.send("TSTART 80")
    two_wired.unit.unplug(1)
    assert two_wired.send("TX 0001") == "0101UNOCCUPIED\n0080"
    assert two_wired.raw("BX 0001")[6:9] == b"\x01\x01\x04"
    two_wired.unit.plug(1)
    assert two_wired.send("TX 0001") == "0101UNOCCUPIED\n00C0"
    two_wired.send("TSTOP ")
    assert two_wired.send("PHSR 01") == "0101030"
    assert two_wired.send("PINIT 01") == "ERROR2C"
    assert two_wired.send("PHINF 01") == "UNOCCUPIED"
    assert two_wired.send("PHSR 02") == "0202001" + "03001"  # it has come back with a new handle
    assert two_wired.send("PHF 01") == "OKAY"
    assert two_wired.send("PHSR 01") == "00"
    two_wired.send("TSTART 80")
    assert two_wired.send("TX 0001") == "000000"  # the search has looked after the changes


def test_a_wired_dummy_and_a_real_wired_tool_exclude_each_other(two_wired: Bench) -> None:
    two_wired.send("PHRQ *********00301")
    for line in ("PINIT 01", "PENA 01D", "PINIT 03", "PENA 03D"):
        assert two_wired.send(line) == "OKAY"
    assert two_wired.send("TSTART 80") == "ERROR12"
    two_wired.send("PDIS 03")
    assert two_wired.send("TSTART 80") == "OKAY"


def test_a_passive_dummy_works_alongside_wired_tools(two_wired: Bench) -> None:
    assert two_wired.send("PHRQ *********1**01") == "03"
    for line in ("PINIT 01", "PENA 01D", "PINIT 03", "PENA 03D", "TSTART 80"):
        assert two_wired.send(line) == "OKAY"
    assert two_wired.send("TX 1801").split("\n")[2].startswith("03")  # the dummy lights the strays


def test_definition_files_are_plugged_in_as_wired_tools_and_bad_ones_refused(
    tmp_path: Path, pointer: TrackerTool
) -> None:
    file = tmp_path / "pointer.rom"
    file.write_bytes(write_definition(pointer))
    assert plug_in([file, file], SOCKETS, USER_BYTES).plugged == {1, 2}
    assert plug_in([], SOCKETS, USER_BYTES).count == 0
    with raises(BAD_WIRED_TOOL, match="no port left for wired tool 1"):
        plug_in([file], 0, USER_BYTES)
    with raises(BAD_WIRED_TOOL, match="cannot read"):
        plug_in([tmp_path / "nothing.rom"], SOCKETS, USER_BYTES)
    file.write_bytes(b"short")
    with raises(BAD_WIRED_TOOL, match="5 bytes"):
        plug_in([file], SOCKETS, USER_BYTES)
