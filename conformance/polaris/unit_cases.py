"""Checklist lines 1 to 10, 17 to 23 and 47: line, commands and replies, port handles, tool definitions."""

from __future__ import annotations

import time

from conformance.case import DESTRUCTIVE, CaseList, NotShown, check
from conformance.polaris.client import (
    FAST_ARGUMENT,
    FAST_BAUD,
    RESET_LIMIT_S,
    PolarisLink,
    idle_unit,
    is_error,
    with_crc,
)
from conformance.polaris.fixtures import (
    NEEDS,
    PUBLISHED_PART,
    SERIAL,
    WITH_TOOL,
    build_published_definition,
    unit_with_tool,
)
from ronna_hw.wire import polaris_rom as layout
from ronna_hw.wire.polaris import DEFAULT_BAUD, PVWR_BLOCK_BYTES, PVWR_SPACE_BYTES, REPLY_RESET

QUICK_INIT_S = 0.15  # if slower, a client that probes for 200 ms sends a break
INIT_LIMIT_S = 4.0  # the unit's own
INITS = 5
RESET_SETTLING_S = 0.2

CASES = CaseList()
case = CASES.case
on_unit = CASES.within(idle_unit, *NEEDS)
on_serial_line = CASES.within(idle_unit, *SERIAL)
on_tool = CASES.within(unit_with_tool, *WITH_TOOL)


@on_serial_line("P01", "after a break the unit sends RESET at 9600 baud, 8N1", needs=(DESTRUCTIVE,))
def break_resets(unit: PolarisLink) -> None:
    try:
        unit.switch_baud(FAST_ARGUMENT, FAST_BAUD)
        check(not is_error(unit.ask("APIREV:")), f"a reply at {FAST_BAUD} baud")
        unit.serial.send_break()
    finally:
        unit.serial.baud = DEFAULT_BAUD
    reply = unit.text(RESET_LIMIT_S)
    check(reply == REPLY_RESET, "RESET after a break", reply)
    unit.refused("PHSR:00", 0x10)
    unit.expect_okay("INIT:")


@on_unit("P01b", "RESET 0 works like a break: the unit sends RESET and needs INIT", needs=(DESTRUCTIVE,))
def reset_command(unit: PolarisLink) -> None:
    unit.send("RESET:0")
    reply = unit.text(RESET_LIMIT_S)
    check(reply == REPLY_RESET, "RESET", reply)
    time.sleep(RESET_SETTLING_S)
    unit.refused("PHSR:00", 0x10)
    unit.expect_okay("INIT:")


@on_unit("P02", "every text reply ends in four upper-case hex digits of CRC and CR")
def replies_carry_a_crc(unit: PolarisLink) -> None:
    for command in ("APIREV:", "VER:4", "VER:0", "PHSR:00", "GET:Features.Firmware.Version"):
        unit.ask(command)


@on_unit("P03", "a command with a wrong CRC returns ERROR04 and has no effect")
def wrong_crc_has_no_effect(unit: PolarisLink) -> None:
    good = with_crc("PHRQ:*********1****")
    unit.refused(good[:-2] + (b"0" if good[-2:-1] != b"0" else b"1") + b"\r", 0x04)
    check(unit.handles() == [], "no handle allocated", unit.handles())


@on_unit("P04", "a command with a space needs no CRC; its reply has one")
def space_form(unit: PolarisLink) -> None:
    check(unit.ask(b"APIREV \r") == unit.ask("APIREV:"), "the same reply in both forms")


@on_unit("P05", "INIT without any separator is accepted")
def bare_init(unit: PolarisLink) -> None:
    unit.expect_okay(b"INIT\r")


@on_unit("P06", "an unknown command returns ERROR01")
def unknown_command(unit: PolarisLink) -> None:
    unit.refused("XYZZY:", 0x01)


@on_unit("P07", "a command that arrives byte by byte is accepted")
def byte_by_byte(unit: PolarisLink) -> None:
    for byte in with_crc("APIREV:"):
        unit.send(bytes([byte]))
        time.sleep(0.002)
    check(not is_error(unit.text()), "the reply to APIREV")


@on_serial_line("P08", "OKAY to COMM comes at the old baud rate, then the unit uses the new one")
def rate_changes_after_the_answer(unit: PolarisLink) -> None:
    information = unit.ask("APIREV:")
    with unit.fast_baud():
        check(unit.ask("APIREV:") == information, f"the same reply at {FAST_BAUD} baud")
    check(unit.ask("APIREV:") == information, f"the same reply at {DEFAULT_BAUD} baud again")


@on_unit("P09", "before INIT, commands about tools and tracking return ERROR10", needs=(DESTRUCTIVE,))
def set_up_before_init(unit: PolarisLink) -> None:
    unit.send("RESET:0")
    unit.text(RESET_LIMIT_S)
    time.sleep(RESET_SETTLING_S)
    for command in ("PHSR:00", "PHRQ:*********1****", "SFLIST:03", "TSTART:80", "TSTOP:", "BX:0001"):
        unit.refused(command, 0x10)
    unit.expect_okay("INIT:")
    check(unit.handles() == [], "no handles after INIT", unit.handles())


@on_unit("P10", "INIT is answered within 150 ms, before a probing client sends a break")
def init_is_quick(unit: PolarisLink) -> None:
    took_s = []
    for _ in range(INITS):
        began_s = time.monotonic()
        unit.expect_okay("INIT:")
        took_s.append(time.monotonic() - began_s)
    quickest_s = min(took_s)
    check(quickest_s <= INIT_LIMIT_S, f"a reply within the unit's limit of {INIT_LIMIT_S:g} s", quickest_s)
    if quickest_s > QUICK_INIT_S:
        raise NotShown(
            f"INIT takes {quickest_s:.2f} s: allowed, but a client that probes for 200 ms sends a break"
        )


NOT_A_WHOLE_BLOCK = (0x02, 0x03, 0x07)
NO_SUCH_ADDRESS = (0x23, 0x36, 0x37, 0x07)  # which one is undocumented


@on_unit("P17", "PHRQ returns distinct nonzero handles, PHF frees them")
def handles_are_distinct(unit: PolarisLink) -> None:
    handles = [unit.request_handle() for _ in range(3)]
    check(len(set(handles)) == 3, "three handles", handles)
    check(unit.handles() == sorted(handles), f"the handles {handles}", unit.handles())
    unit.expect_okay(f"PHF:{handles[1]}")
    unit.refused(f"PHF:{handles[1]}", 0x2B)
    check(handles[1] not in unit.handles(), "the freed handle gone")


@on_tool("P18", "PHSR lists a handle as occupied, initialised or enabled at each step")
def handle_lists(unit: PolarisLink) -> None:
    handle = unit.request_handle()
    _check_listed(unit, handle, "00", "02")
    unit.expect_okay(f"PHF:{handle}")
    handle = unit.load_tool(unit.definition)
    _check_listed(unit, handle, "00", "04")
    unit.expect_okay(f"PDIS:{handle}")
    _check_listed(unit, handle, "00", "03")


@on_unit("P19", "PVWR accepts blocks of 64 bytes up to address 07C0, in upper- or lower-case hex")
def memory_is_written_in_blocks(unit: PolarisLink) -> None:
    handle = unit.request_handle()
    content = bytes(range(0xA0, 0xA0 + PVWR_BLOCK_BYTES)).hex()
    for address in range(0, PVWR_SPACE_BYTES, PVWR_BLOCK_BYTES):
        unit.expect_okay(f"PVWR:{handle}{address:04X}{content.upper()}")
    unit.expect_okay(f"PVWR:{handle.lower()}07c0{content}")
    unit.refused(f"PVWR:{handle}0800{content}", *NO_SUCH_ADDRESS)
    unit.refused(f"PVWR:{handle}0000{content[:-2]}", *NOT_A_WHOLE_BLOCK)


@on_tool("P20", "PINIT refuses a definition with a wrong checksum")
def wrong_checksum(unit: PolarisLink) -> None:
    block = bytearray(unit.definition)
    block[72] ^= 0x40
    handle = unit.request_handle()
    for address in range(0, len(block), 64):
        chunk = bytes(block[address : address + 64]).ljust(64, b"\0")
        unit.expect_okay(f"PVWR:{handle}{address:04x}{chunk.hex()}")  # lower-case hex is also understood
    unit.refused(f"PINIT:{handle}", 0x13, 0x40, 0x41)


@on_tool("P21", "PENA refuses a handle that is not initialised, and an unknown priority")
def enabling_needs_initialising(unit: PolarisLink) -> None:
    unit.refused(f"PENA:{unit.request_handle()}D", 0x0E)
    unit.refused(f"PENA:{unit.load_tool(unit.definition)}X", 0x09)


@on_tool("P22", "PHINF returns type, manufacturer, revision, serial and part number of the definition")
def tool_information(unit: PolarisLink) -> None:
    _check_information(unit, unit.load_tool(unit.definition), unit.definition)


@on_tool("P23", "PHINF returns options 0001, 0004 and 0020 in sequence, 67 characters")
def joined_information(unit: PolarisLink) -> None:
    handle = unit.load_tool(unit.definition)
    joined = unit.ask(f"PHINF:{handle}0025")
    check(len(joined) == 67, "67 characters", len(joined))
    parts = [unit.ask(f"PHINF:{handle}{option}") for option in ("0001", "0004", "0020")]
    check([len(part) for part in parts] == [33, 20, 14], "parts of 33, 20 and 14 characters", parts)
    check(joined == "".join(parts), "the parts in the order of their bits", joined)


@on_tool("P47", "a generated definition and one with a manufacturer's published numbers both load")
def both_makers_definitions_load(unit: PolarisLink) -> None:
    ours, theirs = unit.definition, build_published_definition()
    handles = unit.load_tool(ours), unit.load_tool(theirs)
    check(unit.handles("04") == sorted(handles), "both enabled", unit.handles("04"))
    _check_information(unit, handles[0], ours)
    _check_information(unit, handles[1], theirs)
    part = unit.ask(f"PHINF:{handles[1]}0004")
    check(part.rstrip().encode() == PUBLISHED_PART, PUBLISHED_PART.decode(), part)


def _check_listed(unit: PolarisLink, handle: str, *queries: str) -> None:
    """Check that the handle is listed by exactly these of the five PHSR queries."""
    found = tuple(query for query in ("00", "01", "02", "03", "04") if handle in unit.handles(query))
    check(found == queries, f"handle {handle} under {' and '.join(queries)}", found)


def _check_information(unit: PolarisLink, handle: str, block: bytes) -> None:
    information = unit.ask(f"PHINF:{handle}0001")
    check(len(information) == 33, "33 characters", len(information))
    check(int(information[:2], 16) == block[layout.MAIN_TYPE_OFFSET], "the main type", information[:2])
    check(int(information[6:8], 16) == block[layout.SUBTYPE_OFFSET], "the subtype", information[6:8])
    maker = _text(block, layout.MANUFACTURER_OFFSET, layout.MANUFACTURER_BYTES)
    check(information[8:20].rstrip() == maker, f"the manufacturer {maker}", information[8:20])
    revision = int.from_bytes(block[layout.REVISION_OFFSET : layout.REVISION_OFFSET + 2], "little")
    check(information[20:23] == f"{revision:03d}", f"revision {revision:03d}", information[20:23])
    serial = block[layout.SERIAL_OFFSET : layout.SERIAL_OFFSET + 4]
    # As a number or byte by byte: undocumented.
    orders = [serial[::-1].hex().upper(), serial.hex().upper()]
    check(information[23:31] in orders, f"serial {' or '.join(orders)}", information[23:31])
    part = unit.ask(f"PHINF:{handle}0004")
    check(len(part) == 20, "20 characters", len(part))
    number = _text(block, layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_BYTES)
    check(part.rstrip() == number, f"the part number {number}", part)


def _text(block: bytes, offset: int, size: int) -> str:
    return block[offset : offset + size].split(b"\0", 1)[0].decode("ascii", "replace").rstrip()
