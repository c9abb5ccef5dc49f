"""Checklist lines 17 to 23 and 47: port handles and tool definitions."""

from __future__ import annotations

from conformance.case import CaseList, check
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.definitions import PUBLISHED_PART, published
from conformance.polaris.link import PolarisLink, idle_unit
from conformance.polaris.suite import NEEDS, WITH_TOOL, definition
from ronna_hw.wire import polaris_rom as layout
from ronna_hw.wire.polaris import PVWR_BLOCK_BYTES, PVWR_SPACE_BYTES

NOT_A_WHOLE_BLOCK = (0x02, 0x03, 0x07)
NO_SUCH_ADDRESS = (0x23, 0x36, 0x37, 0x07)  # which one is undocumented

CASES = CaseList()
case = CASES.case


@case("P17", "PHRQ returns distinct nonzero handles, PHF frees them", needs=NEEDS)
def handles_are_distinct(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        handles = [unit.request_handle() for _ in range(3)]
        check(len(set(handles)) == 3, "three handles", handles)
        check(unit.handles() == sorted(handles), f"the handles {handles}", unit.handles())
        unit.okay(f"PHF:{handles[1]}")
        unit.refused(f"PHF:{handles[1]}", 0x2B)
        check(handles[1] not in unit.handles(), "the freed handle gone")


@case("P18", "PHSR lists a handle as occupied, initialised or enabled at each step", needs=WITH_TOOL)
def handle_lists(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        handle = unit.request_handle()
        _is_listed_under(unit, handle, "00", "02")
        unit.okay(f"PHF:{handle}")
        handle = unit.load(block)
        _is_listed_under(unit, handle, "00", "04")
        unit.okay(f"PDIS:{handle}")
        _is_listed_under(unit, handle, "00", "03")


@case("P19", "PVWR accepts blocks of 64 bytes up to address 07C0, in upper- or lower-case hex", needs=NEEDS)
def memory_is_written_in_blocks(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        handle = unit.request_handle()
        content = bytes(range(0xA0, 0xA0 + PVWR_BLOCK_BYTES)).hex()
        for address in range(0, PVWR_SPACE_BYTES, PVWR_BLOCK_BYTES):
            unit.okay(f"PVWR:{handle}{address:04X}{content.upper()}")
        unit.okay(f"PVWR:{handle.lower()}07c0{content}")
        unit.refused(f"PVWR:{handle}0800{content}", *NO_SUCH_ADDRESS)
        unit.refused(f"PVWR:{handle}0000{content[:-2]}", *NOT_A_WHOLE_BLOCK)


@case("P20", "PINIT refuses a definition with a wrong checksum", needs=WITH_TOOL)
def wrong_checksum(dut: DeviceUnderTest) -> None:
    block = bytearray(definition(dut))
    block[72] ^= 0x40
    with idle_unit(dut) as unit:
        handle = unit.request_handle()
        for address in range(0, len(block), 64):
            chunk = bytes(block[address : address + 64]).ljust(64, b"\0")
            unit.okay(f"PVWR:{handle}{address:04x}{chunk.hex()}")  # lower-case hex is also understood
        unit.refused(f"PINIT:{handle}", 0x13, 0x40, 0x41)


@case("P21", "PENA refuses a handle that is not initialised, and an unknown priority", needs=WITH_TOOL)
def enabling_needs_initialising(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.refused(f"PENA:{unit.request_handle()}D", 0x0E)
        unit.refused(f"PENA:{unit.load(block)}X", 0x09)


@case(
    "P22",
    "PHINF returns type, manufacturer, revision, serial and part number of the definition",
    needs=WITH_TOOL,
)
def tool_information(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        _tells_the_definition(unit, unit.load(block), block)


@case("P23", "PHINF returns options 0001, 0004 and 0020 in sequence, 67 characters", needs=WITH_TOOL)
def joined_information(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        handle = unit.load(block)
        joined = unit.ask(f"PHINF:{handle}0025")
        check(len(joined) == 67, "67 characters", len(joined))
        parts = [unit.ask(f"PHINF:{handle}{option}") for option in ("0001", "0004", "0020")]
        check([len(part) for part in parts] == [33, 20, 14], "parts of 33, 20 and 14 characters", parts)
        check(joined == "".join(parts), "the parts in the order of their bits", joined)


@case(
    "P47",
    "a generated definition and one with a manufacturer's published numbers both load",
    needs=WITH_TOOL,
)
def both_makers_definitions_load(dut: DeviceUnderTest) -> None:
    ours, theirs = definition(dut), published()
    with idle_unit(dut) as unit:
        handles = unit.load(ours), unit.load(theirs)
        check(unit.handles("04") == sorted(handles), "both enabled", unit.handles("04"))
        _tells_the_definition(unit, handles[0], ours)
        _tells_the_definition(unit, handles[1], theirs)
        part = unit.ask(f"PHINF:{handles[1]}0004")
        check(part.rstrip().encode() == PUBLISHED_PART, PUBLISHED_PART.decode(), part)


def _is_listed_under(unit: PolarisLink, handle: str, *queries: str) -> None:
    """The handle must be listed by exactly these of the five queries."""
    found = tuple(query for query in ("00", "01", "02", "03", "04") if handle in unit.handles(query))
    check(found == queries, f"handle {handle} under {' and '.join(queries)}", found)


def _tells_the_definition(unit: PolarisLink, handle: str, block: bytes) -> None:
    about = unit.ask(f"PHINF:{handle}0001")
    check(len(about) == 33, "33 characters", len(about))
    check(int(about[:2], 16) == block[layout.MAIN_TYPE_OFFSET], "the main type", about[:2])
    check(int(about[6:8], 16) == block[layout.SUBTYPE_OFFSET], "the subtype", about[6:8])
    maker = _text(block, layout.MANUFACTURER_OFFSET, layout.MANUFACTURER_BYTES)
    check(about[8:20].rstrip() == maker, f"the manufacturer {maker}", about[8:20])
    revision = int.from_bytes(block[layout.REVISION_OFFSET : layout.REVISION_OFFSET + 2], "little")
    check(about[20:23] == f"{revision:03d}", f"revision {revision:03d}", about[20:23])
    serial = block[layout.SERIAL_OFFSET : layout.SERIAL_OFFSET + 4]
    # As a number or byte by byte: undocumented.
    orders = [serial[::-1].hex().upper(), serial.hex().upper()]
    check(about[23:31] in orders, f"serial {' or '.join(orders)}", about[23:31])
    part = unit.ask(f"PHINF:{handle}0004")
    check(len(part) == 20, "20 characters", len(part))
    number = _text(block, layout.PART_NUMBER_OFFSET, layout.PART_NUMBER_BYTES)
    check(part.rstrip() == number, f"the part number {number}", part)


def _text(block: bytes, offset: int, size: int) -> str:
    return block[offset : offset + size].split(b"\0", 1)[0].decode("ascii", "replace").rstrip()
