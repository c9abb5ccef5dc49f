"""Checklist lines 24 to 34 and 49: modes, frame numbers, and TX and BX formats."""

from __future__ import annotations

import math
import re
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager

from conformance.case import HOST_TIME, CaseList, NotShown, check, require_present
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.client import TOOL_INFORMATION_BYTES, PolarisLink, idle_unit
from conformance.polaris.fixtures import (
    NEEDS,
    WITH_TOOL,
    definition,
    read_frame,
    reverse_normals,
    unit_with_tool,
)
from ronna_hw.wire.polaris import FRAME_RATE_HZ, HandleStatus, PortStatus

FRAME_RATE_SPAN_S = 0.5
FRAME_RATE_TOLERANCE_FRAMES = 4  # a busy computer requests slightly late
QUICK_REQUESTS = 40
COUNTS_REQUESTS = (
    "every request returns the next frame immediately, however long the pause before it: the unit does not "
    "follow the host's clock; give its clock with --config"
)
POSITION_TOLERANCE_MM = 0.0051  # half of the last digit of TX
QUATERNION_TOLERANCE = 5.1e-5
NORM_TOLERANCE = 1e-3
NOTHING_MORE_S = 0.1  # a reply has ended once the line has been quiet for this long
SAME_FRAME_TRIES = 20
TX_POSE = re.compile(r"(?:[+-][0-9]{5}){4}(?:[+-][0-9]{6}){3}[+-][0-9]{5}")
TX_INFORMATION_CHARACTERS = 22
LOADED_STATUS = PortStatus.OCCUPIED | PortStatus.INITIALISED | PortStatus.ENABLED
UNKNOWN_COMMANDS = ("ERROR01", "ERROR33")

CASES = CaseList()
case = CASES.case
on_unit = CASES.within(idle_unit, *NEEDS)
on_tool = CASES.within(unit_with_tool, *WITH_TOOL)


@contextmanager
def tracking(dut: DeviceUnderTest, block: bytes | None = None) -> Iterator[PolarisLink]:
    """Yield a unit that tracks one tool, by default the driver's first."""
    block = block or definition(dut)
    with idle_unit(dut) as unit:
        unit.load_tool(block)
        unit.expect_okay("TSTART:80")
        yield unit


while_tracking = CASES.within(tracking, *WITH_TOOL)


@while_tracking("P24", "while tracking, TSTART and setting up handles return ERROR0C")
def set_up_while_tracking(unit: PolarisLink) -> None:
    handle = read_frame(unit).handles[0].handle
    for command in ("TSTART:80", "PHSR:00", f"PENA:{handle}D"):
        unit.refused(command, 0x0C)


@on_unit("P25", "outside tracking, TX, BX and TSTOP return ERROR0C")
def reading_while_idle(unit: PolarisLink) -> None:
    for command in ("TX:0001", "BX:0001", "TSTOP:"):
        unit.refused(command, 0x0C)


@case("P26", "TSTART 80 restarts the frame number", needs=WITH_TOOL)
def frame_number_restarts(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.load_tool(block)
        for _ in range(2):
            unit.expect_okay("TSTART:80")
            first = frame_number(unit)
            check(first <= FRAME_RATE_HZ, "a small frame number", first)
            dut.clock.sleep(0.1)
            check(frame_number(unit) > first, f"a frame number above {first}")
            unit.expect_okay("TSTOP:")


@case("P27", "the frame number advances at 60 per second", needs=(*WITH_TOOL, HOST_TIME))
def frame_rate(dut: DeviceUnderTest) -> None:
    with tracking(dut) as unit:
        began_s, first = time.monotonic(), frame_number(unit)
        time.sleep(FRAME_RATE_SPAN_S)
        requested_s = time.monotonic()
        last = frame_number(unit)
        least = (requested_s - began_s) * FRAME_RATE_HZ - FRAME_RATE_TOLERANCE_FRAMES
        most = (time.monotonic() - began_s) * FRAME_RATE_HZ + FRAME_RATE_TOLERANCE_FRAMES
        if last - first == 1 and not dut.clock_known and _is_counting_requests(unit):
            raise NotShown(COUNTS_REQUESTS)
        check(least <= last - first <= most, f"{least:.0f} to {most:.0f} frames", last - first)


@while_tracking("P28", "TX has the exact form of its options: LF after each handle, four digits at the end")
def tx_grammar(unit: PolarisLink) -> None:
    handle = read_frame(unit).handles[0].handle
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
        match = require_present(re.fullmatch(form, text), f"the form of TX {options}", repr(text))
        if options == "1801":
            count = int(match[1], 16)
            check(len(match[2]) == (count + 3) // 4, "one bit per stray", match[2])
            check(len(match[3]) == 21 * count, "a position per stray", len(match[3]))


@case("P30", "TX and BX of one frame agree within the rounding of TX", needs=WITH_TOOL)
def tx_and_bx_agree(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit, unit.fast_baud():  # both within one frame
        unit.load_tool(block)
        unit.expect_okay("TSTART:80")
        for _ in range(SAME_FRAME_TRIES):
            text, body = unit.ask("TX:0801"), unit.ask_binary("BX:0801")
            if not TX_POSE.match(text, 4) or body[2] != HandleStatus.VALID:
                dut.clock.sleep(0.02)
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


@case("P31", "a missing tool has its status and frame number, in TX and in BX", needs=WITH_TOOL)
def missing_keeps_its_frame(dut: DeviceUnderTest) -> None:
    with tracking(dut, reverse_normals(definition(dut))) as unit:
        before = read_frame(unit).handles[0]
        dut.clock.sleep(0.1)
        after = read_frame(unit).handles[0]
        text = unit.ask("TX:0001")
        if HandleStatus.VALID in (before.status, after.status):
            raise NotShown("the tool is tracked although its markers face away")
        check(after.status is HandleStatus.MISSING, "the status of a missing tool", after.status)
        check(
            after.port_status & LOADED_STATUS == LOADED_STATUS, "port status 31", f"{after.port_status:04X}"
        )
        check(after.frame > before.frame, f"a frame number above {before.frame}", after.frame)
        form = rf"01{after.handle}MISSING[0-9A-F]{{8}}([0-9A-F]{{8}})\n[0-9A-F]{{4}}"
        match = require_present(re.fullmatch(form, text), "MISSING, status and frame number", repr(text))
        check(int(match[1], 16) >= after.frame, f"a frame number of {after.frame} or more", match[1])


@on_tool("P31b", "a disabled tool is omitted, or listed without status and frame number")
def disabled_carries_nothing(unit: PolarisLink) -> None:
    disabled, enabled = unit.load_tool(reverse_normals(unit.definition)), unit.load_tool(unit.definition)
    unit.expect_okay(f"PDIS:{disabled}")
    unit.expect_okay("TSTART:80")
    frame = read_frame(unit)
    listed = {reading.handle: reading.status for reading in frame.handles}
    check(
        listed.pop(disabled, HandleStatus.DISABLED) is HandleStatus.DISABLED,
        "no pose of the disabled tool",
        listed,
    )
    check(list(listed) == [enabled], f"handle {enabled}", list(listed))
    text = unit.ask("TX:0001")
    pose = rf"(?:{TX_POSE.pattern}|MISSING)[0-9A-F]{{16}}\n"
    form = rf"0[12](?:{disabled}DISABLED\n)?{enabled}{pose}(?:{disabled}DISABLED\n)?[0-9A-F]{{4}}"
    check(re.fullmatch(form, text) is not None, "nothing after DISABLED", repr(text))


@while_tracking("P32", "BX has the right length and CRCs, and nothing follows it")
def bx_is_whole(unit: PolarisLink) -> None:
    for options in ("0001", "0801", "1801"):
        unit.ask_binary(f"BX:{options}")
        check(unit.read_rest(NOTHING_MORE_S) == b"", "nothing after the reply")


@while_tracking("P33", "BX contains little-endian float32")
def little_endian(unit: PolarisLink) -> None:
    body = unit.ask_binary("BX:0801")
    if body[2] != HandleStatus.VALID:
        raise NotShown("the tool is not in view")
    norms = {order: math.hypot(*struct.unpack_from(f"{order}4f", body, 3)) for order in "<>"}
    check(abs(norms["<"] - 1.0) <= NORM_TOLERANCE, "norm 1 as little-endian", norms["<"])
    check(not abs(norms[">"] - 1.0) <= NORM_TOLERANCE, "another norm as big-endian", norms[">"])


@while_tracking("P34", "option 0002 adds 22 characters to each handle of TX and 11 bytes of BX")
def tool_information_is_added(unit: PolarisLink) -> None:
    for _ in range(SAME_FRAME_TRIES):
        short, long = unit.ask_binary("BX:0001"), unit.ask_binary("BX:0003")
        texts = unit.ask("TX:0001"), unit.ask("TX:0003")
        missing = {"MISSING" in text for text in texts} | {body[2] == 2 for body in (short, long)}
        if len(missing) == 1:  # tracked in every frame, or missing in every frame
            check(len(long) - len(short) == TOOL_INFORMATION_BYTES, "11 bytes more", len(long) - len(short))
            more = len(texts[1]) - len(texts[0])
            check(more == TX_INFORMATION_CHARACTERS, "22 characters more", more)
            return
    raise NotShown("the tool came and went between two frames")


@on_unit("P49", "DSTART and DSTOP switch between setup and diagnostic mode, in which nothing is tracked")
def diagnostic_mode(unit: PolarisLink) -> None:
    reply = unit.ask("DSTART:")
    if reply in UNKNOWN_COMMANDS:
        raise NotShown(f"this unit has no diagnostic mode: {reply}")
    check(reply == "OKAY", "OKAY to DSTART", reply)
    try:
        for command in ("DSTART:", "TSTART:80", "TX:0001", "BX:0001", "TSTOP:"):
            unit.refused(command, 0x0C)
    finally:
        unit.expect_okay("DSTOP:")
    unit.refused("DSTOP:", 0x0C)
    check(unit.handles() == [], "setup mode again", unit.handles())


def frame_number(unit: PolarisLink) -> int:
    """Read the frame number of the only loaded tool."""
    return read_frame(unit).frame


def _is_counting_requests(unit: PolarisLink) -> bool:
    """Return whether each of many quick requests returns the next frame, faster than 60 per second.

    After a pause of a single frame no clock explains that: a unit that slow would repeat its frame, or delay
    each reply until the next.
    """
    before = frame_number(unit)
    deadline_s = time.monotonic() + (QUICK_REQUESTS - FRAME_RATE_TOLERANCE_FRAMES) / FRAME_RATE_HZ
    for _ in range(QUICK_REQUESTS):
        number = frame_number(unit)
        if number - before != 1 or time.monotonic() >= deadline_s:
            return False
        before = number
    return True
