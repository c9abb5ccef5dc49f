"""What a unit that speaks the NDI Polaris protocol must do, byte by byte, past the driver.

The number of a case is P and a line of the protocol's checklist. Every case leaves the unit initialised,
idle and without tools.
"""

from __future__ import annotations

import re
import struct
import time

from ronna_hw.conformance.bench import Bench
from ronna_hw.conformance.case import NotShown, Suite, check
from ronna_hw.conformance.polaris_link import PolarisLink, idle_unit, is_error, with_crc
from ronna_hw.wire.polaris import FRAME_RATE_HZ, SFLIST_VOLUME_CHARACTERS, HandleStatus

NEEDS = ("polaris bytes",)
WITH_TOOL = (*NEEDS, "tool definition")
FRAME_RATE_SPAN_S = 0.5
FRAME_RATE_TOLERANCE_FRAMES = 4  # a busy computer asks a little late
QUICK_REQUESTS = 40
COUNTS_REQUESTS = (
    "each request gets the next frame at once, however long the pause before: the unit follows a clock that "
    "is not the host's; name that clock with --config"
)
POSITION_TOLERANCE_MM = 0.0051  # half of the last digit of TX
QUATERNION_TOLERANCE = 5.1e-5
NOTHING_MORE_S = 0.1  # how long a line must be quiet to say that a reply has ended
SAME_FRAME_TRIES = 20
TX_POSE = re.compile(r"(?:[+-][0-9]{5}){4}(?:[+-][0-9]{6}){3}[+-][0-9]{5}")

POLARIS_UNIT = Suite("polaris unit", driver="ndi_polaris", simulator=())
case = POLARIS_UNIT.case


def definition(bench: Bench) -> bytes:
    """The first tool definition that the driver would send."""
    blocks: dict[str, bytes] = bench.make().definition_blocks
    return next(iter(blocks.values()))


@case("P02", "every text reply ends in four upper-case hex digits of CRC and CR", needs=NEEDS)
def replies_carry_a_crc(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        for command in ("APIREV:", "VER:4", "VER:0", "PHSR:00", "GET:Features.Firmware.Version"):
            unit.ask(command)


@case("P03", "a command with a wrong CRC is answered ERROR04 and has no effect", needs=NEEDS)
def wrong_crc_has_no_effect(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        good = with_crc("PHRQ:*********1****")
        unit.refused(good[:-2] + (b"0" if good[-2:-1] != b"0" else b"1") + b"\r", 0x04)
        check(unit.handles() == [], "no handle allocated", unit.handles())


@case("P04", "the form with a space needs no CRC, its reply has one", needs=NEEDS)
def space_form(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        check(unit.ask(b"APIREV \r") == unit.ask("APIREV:"), "the same answer in both forms")


@case("P05", "INIT without any separator is accepted", needs=NEEDS)
def bare_init(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        unit.okay(b"INIT\r")


@case("P06", "an unknown command is answered ERROR01", needs=NEEDS)
def unknown_command(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        unit.refused("XYZZY:", 0x01)


@case("P07", "a command that arrives byte by byte is understood", needs=NEEDS)
def byte_by_byte(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        for byte in with_crc("APIREV:"):
            unit.send(bytes([byte]))
            time.sleep(0.002)
        check(not is_error(unit.text()), "the answer to APIREV")


@case("P17", "PHRQ gives distinct handles that are not zero, PHF frees them", needs=NEEDS)
def handles_are_distinct(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        handles = [unit.request_handle() for _ in range(3)]
        check(len(set(handles)) == 3, "three handles", handles)
        check(unit.handles() == sorted(handles), f"the handles {handles}", unit.handles())
        unit.okay(f"PHF:{handles[1]}")
        unit.refused(f"PHF:{handles[1]}", 0x2B)
        check(handles[1] not in unit.handles(), "a freed handle to be gone")


@case("P18", "PHSR lists a handle as occupied, initialised or enabled at each step", needs=WITH_TOOL)
def handle_lists(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        handle = unit.request_handle()
        check(handle in unit.handles("02"), "a new handle under 02", unit.handles("02"))
        unit.okay(f"PHF:{handle}")
        handle = unit.load(block)
        check(handle in unit.handles("04"), "a loaded tool under 04", unit.handles("04"))
        check(handle not in unit.handles("02"), "a loaded tool no more under 02")
        unit.okay(f"PDIS:{handle}")
        check(handle in unit.handles("03"), "a disabled tool under 03", unit.handles("03"))


@case("P20", "PINIT refuses a definition with a wrong checksum", needs=WITH_TOOL)
def wrong_checksum(bench: Bench) -> None:
    block = bytearray(definition(bench))
    block[72] ^= 0x40
    with idle_unit(bench) as unit:
        handle = unit.request_handle()
        for address in range(0, len(block), 64):
            chunk = bytes(block[address : address + 64]).ljust(64, b"\0")
            unit.okay(f"PVWR:{handle}{address:04x}{chunk.hex()}")  # either case of hex is understood
        unit.refused(f"PINIT:{handle}", 0x13, 0x40, 0x41)


@case("P21", "PENA refuses a handle that is not initialised, and an unknown priority", needs=WITH_TOOL)
def enabling_needs_initialising(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.refused(f"PENA:{unit.request_handle()}D", 0x0E)
        unit.refused(f"PENA:{unit.load(block)}X", 0x09)


@case("P22", "PHINF tells main type, maker and part number of the loaded definition", needs=WITH_TOOL)
def tool_information(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        handle = unit.load(block)
        about = unit.ask(f"PHINF:{handle}0001")
        check(len(about) == 33, "33 characters", len(about))
        check(int(about[:2], 16) == block[15], f"main type {block[15]:02X}", about[:2])
        maker = block[580:592].rstrip(b"\0").decode()
        check(about[8:20].rstrip() == maker, f"the maker {maker}", about[8:20])
        part = unit.ask(f"PHINF:{handle}0004")
        check(len(part) == 20, "20 characters", len(part))
        check(part.rstrip() == block[592:612].rstrip(b"\0").decode(), "the part number", part)
        check(len(unit.ask(f"PHINF:{handle}0025")) == 67, "67 characters for options 0025")


@case("P24", "while tracking, TSTART and the set-up of handles are answered ERROR0C", needs=WITH_TOOL)
def set_up_while_tracking(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        handle = unit.load(block)
        unit.okay("TSTART:80")
        for command in ("TSTART:80", "PHSR:00", f"PENA:{handle}D"):
            unit.refused(command, 0x0C)


@case("P25", "outside tracking, TX, BX and TSTOP are answered ERROR0C", needs=NEEDS)
def reading_while_idle(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        for command in ("TX:0001", "BX:0001", "TSTOP:"):
            unit.refused(command, 0x0C)


@case("P26", "TSTART 80 begins the frame number anew", needs=WITH_TOOL)
def frame_number_restarts(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.load(block)
        for _ in range(2):
            unit.okay("TSTART:80")
            first = _frame(unit)
            check(first <= FRAME_RATE_HZ, "a small frame number", first)
            bench.clock.sleep(0.1)
            check(_frame(unit) > first, f"a frame number above {first}")
            unit.okay("TSTOP:")


@case("P27", "the frame number advances at 60 per second", needs=(*WITH_TOOL, "host time"))
def frame_rate(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.load(block)
        unit.okay("TSTART:80")
        began_s, first = time.monotonic(), _frame(unit)
        time.sleep(FRAME_RATE_SPAN_S)
        asked_s = time.monotonic()
        last = _frame(unit)
        least = (asked_s - began_s) * FRAME_RATE_HZ - FRAME_RATE_TOLERANCE_FRAMES
        most = (time.monotonic() - began_s) * FRAME_RATE_HZ + FRAME_RATE_TOLERANCE_FRAMES
        if last - first == 1 and not bench.clock_known and _counts_requests(unit):
            raise NotShown(COUNTS_REQUESTS)
        check(least <= last - first <= most, f"{least:.0f} to {most:.0f} frames", last - first)


@case(
    "P28",
    "TX has the exact form of its options, LF after each handle, four digits at the end",
    needs=WITH_TOOL,
)
def tx_grammar(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        handle = unit.load(block)
        unit.okay("TSTART:80")
        stray = r"(?:[+-][0-9]{6}){3}"
        pose = rf"(?:{TX_POSE.pattern}|MISSING)[0-9A-F]{{16}}"
        forms = {
            "0001": rf"01{handle}{pose}\n[0-9A-F]{{4}}",
            "0801": rf"01{handle}{pose}\n[0-9A-F]{{4}}",
            "0003": rf"01{handle}{pose}[0-9A-F]{{22}}\n[0-9A-F]{{4}}",
            "1801": rf"01{handle}{pose}\n([0-9A-F]{{2}})([0-9A-F]*)((?:{stray})*)[0-9A-F]{{4}}",
        }
        for options, form in forms.items():
            text = unit.ask(f"TX:{options}")
            match = re.fullmatch(form, text)
            check(match is not None, f"the form of TX {options}", repr(text))
            if options == "1801" and match is not None:
                count = int(match[1], 16)
                check(len(match[2]) == (count + 3) // 4, "one bit per stray", match[2])
                check(len(match[3]) == 21 * count, "a position per stray", len(match[3]))


@case("P30", "TX and BX of one frame agree within the rounding of TX", needs=WITH_TOOL)
def tx_and_bx_agree(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.load(block)
        unit.okay("TSTART:80")
        for _ in range(SAME_FRAME_TRIES):
            text, body = unit.ask("TX:0001"), unit.binary("BX:0001")
            if not TX_POSE.match(text, 4) or body[2] != HandleStatus.VALID:
                bench.clock.sleep(0.02)
                continue
            numbers = struct.unpack_from("<8f2I", body, 3)
            if int(text[63:71], 16) != numbers[9]:
                continue  # a new frame between the two
            rounded = [int(text[4 + 6 * k : 10 + 6 * k]) / 1e4 for k in range(4)]
            places = [int(text[28 + 7 * k : 35 + 7 * k]) / 1e2 for k in range(3)]
            for ours, theirs in zip(rounded, numbers[:4], strict=True):
                check(abs(ours - theirs) <= QUATERNION_TOLERANCE, f"{theirs:.6f}", ours)
            for ours, theirs in zip(places, numbers[4:7], strict=True):
                check(abs(ours - theirs) <= POSITION_TOLERANCE_MM, f"{theirs:.4f} mm", ours)
            return
        raise NotShown("no frame with a pose came by both TX and BX")


@case("P32", "BX gives length and both CRCs rightly, and no byte more", needs=WITH_TOOL)
def bx_is_whole(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.load(block)
        unit.okay("TSTART:80")
        for options in ("0001", "0801", "1801"):
            unit.binary(f"BX:{options}")
            check(unit.rest(NOTHING_MORE_S) == b"", "nothing after the reply")


@case("P34", "option 0002 adds 11 bytes to each handle of BX", needs=WITH_TOOL)
def tool_information_in_bx(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.load(block)
        unit.okay("TSTART:80")
        for _ in range(SAME_FRAME_TRIES):
            short, long = unit.binary("BX:0001"), unit.binary("BX:0003")
            if short[2] == long[2]:  # seen both times, or missing both times
                check(len(long) - len(short) == 11, "11 bytes more", len(long) - len(short))
                return
        raise NotShown("the tool came and went between two frames")


@case("P36", "strays are told only while a passive handle is enabled", needs=WITH_TOOL)
def strays_need_illuminators(bench: Bench) -> None:
    block = definition(bench)
    with idle_unit(bench) as unit:
        unit.okay("TSTART:80")
        check(unit.binary("BX:1801")[:2] == b"\0\0", "no handles and no strays")
        unit.okay("TSTOP:")
        unit.load(block)
        unit.okay("TSTART:80")
        body = unit.binary("BX:1801")
        strays = body[3 + (40 if body[2] == HandleStatus.VALID else 8)]
        if not strays:
            raise NotShown("no stray marker is in sight")
        check(strays <= 50, "at most 50 strays", strays)


@case("P44", "GET of an unknown parameter is answered ERROR34", needs=NEEDS)
def unknown_parameter(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        unit.refused("GET:No.Such Parameter", 0x34)


@case("P45", "SFLIST 03 gives each volume in its 74 characters", needs=NEEDS)
def volumes_are_told(bench: Bench) -> None:
    with idle_unit(bench) as unit:
        text = unit.ask("SFLIST:03")
        records = text[1:].split("\n")[:-1] if text.endswith("\n") else text[1:].split("\n")
        check(text[:1].isdigit() and int(text[:1]) == len(records), "as many volumes as announced", text[:1])
        for record in records:
            check(len(record) == SFLIST_VOLUME_CHARACTERS, "74 characters", len(record))
            check(re.fullmatch(r"[0-9A-F](?:[+-][0-9]{6}){10}.*", record) is not None, "ten numbers", record)


def _counts_requests(unit: PolarisLink) -> bool:
    """True when each of many quick requests gets exactly the next frame, sooner than 60 per second allow.

    After a pause with a single frame no clock explains that: a unit so slow would repeat its frame, or keep
    each request waiting for the next.
    """
    before = _frame(unit)
    deadline_s = time.monotonic() + (QUICK_REQUESTS - FRAME_RATE_TOLERANCE_FRAMES) / FRAME_RATE_HZ
    for _ in range(QUICK_REQUESTS):
        number = _frame(unit)
        if number - before != 1 or time.monotonic() >= deadline_s:
            return False
        before = number
    return True


def _frame(unit: PolarisLink) -> int:
    """Frame number of the only handle."""
    body = unit.binary("BX:0001")
    at = 3 + (36 if body[2] == HandleStatus.VALID else 4)
    return int(struct.unpack_from("<I", body, at)[0])
