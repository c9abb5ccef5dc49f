"""Checklist line 50: faults switched on and off at run time, and their effect on the wire.

Needs a control port. Each case clears its fault and leaves the unit as the others need it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

from ronna_hw.conformance.case import LIVE_FAULTS, CaseList, Nonconformity, check
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.polaris.bx_reply import Seen, placed
from ronna_hw.conformance.polaris.definitions import markers_of
from ronna_hw.conformance.polaris.link import RESET_LIMIT_S, PolarisLink, idle_unit, with_crc
from ronna_hw.conformance.polaris.suite import WITH_TOOL, definition, seen
from ronna_hw.conformance.polaris.volumes import volume_in_use
from ronna_hw.wire import polaris_rom as layout
from ronna_hw.wire.polaris import (
    PARAMETER_ALERTS,
    PARAMETER_BUMP_CLEAR,
    PARAMETER_BUMPED,
    PARAMETER_NEW_ALERTS,
    REPLY_RESET,
    Alert,
    HandleStatus,
    MarkerState,
    PortStatus,
    SystemStatus,
    ToolInformation,
)

NEEDS = (*WITH_TOOL, LIVE_FAULTS)
SHOWN_WITHIN_S = 5.0  # host time; a fault acts from the next frame on
LOOK_EVERY_S = 0.02
OUTSIDE_MM = 130.0
HARDWARE_ALERT = Alert.MAIN_VOLTAGE
MORE_STRAYS = 5
SLOWER_S = 0.5
DELAY_S = 0.3
GARBLED_COMMANDS = 10
NOT_TRACKING = ("ERROR0C", REPLY_RESET, "ERROR10")  # stopped or reset: undocumented
SOCKET = 1  # for a wired tool

CASES = CaseList()
case = CASES.case


@contextmanager
def tracking(dut: DeviceUnderTest) -> Iterator[tuple[PolarisLink, str]]:
    """(unit, part number): a unit that tracks one tool; every fault is cleared afterwards."""
    block = definition(dut)
    part = block[layout.PART_NUMBER_OFFSET : layout.PART_NUMBER_OFFSET + layout.PART_NUMBER_BYTES]
    with idle_unit(dut) as unit:
        unit.load(block)
        unit.okay("TSTART:80")
        await_frame(unit, lambda frame: frame.handles[0].pose is not None, "a frame with the tool in it")
        try:
            yield unit, part.split(b"\0", 1)[0].decode("ascii")
        finally:
            dut.clear_faults()


@contextmanager
def faulty(dut: DeviceUnderTest, fault: str) -> Iterator[None]:
    """This fault of the tracker is active inside the block."""
    dut.fault(f"now: tracker {fault}")
    try:
        yield
    finally:
        dut.clear_faults()


def await_frame(unit: PolarisLink, shows: Callable[[Seen], bool], what: str, options: int = 0x0801) -> Seen:
    """The first frame that satisfies `shows`; raises Nonconformity when none does in time."""
    deadline_s = time.monotonic() + SHOWN_WITHIN_S
    while True:
        frame = seen(unit, options)
        if shows(frame):
            return frame
        if time.monotonic() > deadline_s:
            raise Nonconformity(f"expected {what}, got {frame}")
        time.sleep(LOOK_EVERY_S)


def await_pose(unit: PolarisLink) -> None:
    """Wait until the tool is tracked again."""
    await_frame(unit, lambda frame: frame.handles[0].pose is not None, "a pose again")


@case("P50a", "fault: an occluded tool is MISSING, frame numbers go on, no marker is seen", needs=NEEDS)
def occluded(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, part):
        with faulty(dut, f"occlude tool {part}"):
            first = await_frame(unit, _is_missing, "MISSING")
            later = await_frame(unit, lambda frame: frame.frame > first.frame, "increasing frame numbers")
            check(_is_missing(later), "MISSING throughout", later)
            information, digits = _tool_information(unit)
            check(bool(information & ToolInformation.TOO_FEW_MARKERS), "tool information 02", information)
            check(set(digits) == {MarkerState.MISSING}, "no marker seen", digits)
        await_pose(unit)


@case("P50b", "fault: a bent tool does not fit and is MISSING", needs=NEEDS)
def bent(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, part):
        with faulty(dut, f"bend tool {part} 40 mm"):
            await_frame(unit, _is_missing, "MISSING")
            information, digits = _tool_information(unit)
            check(bool(information & ToolInformation.BAD_FIT), "tool information 01", information)
            check(MarkerState.BEYOND_ERROR in digits, "a marker beyond the 3D error", digits)
        await_pose(unit)


@case("P50c", "fault: the markers of a tool that is turned away are beyond the maximum angle", needs=NEEDS)
def turned_away(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, part):
        with faulty(dut, f"turn tool {part} 150 deg"):
            await_frame(unit, _is_missing, "MISSING")
            _, digits = _tool_information(unit)
            check(MarkerState.BEYOND_ANGLE in digits, "a marker beyond the angle", digits)
        await_pose(unit)


@case(
    "P50d",
    "fault: a tool moved out of the volume has status bit 0040, partly out 0080",
    needs=NEEDS,
)
def moved_out(dut: DeviceUnderTest) -> None:
    markers_mm = markers_of(definition(dut))
    with tracking(dut) as (unit, part):
        pose = seen(unit, 0x0801).handles[0].pose
        assert pose is not None, "tracking() waits for a frame with the tool"
        unit.okay("TSTOP:")
        volume = volume_in_use(unit)
        unit.okay("TSTART:80")
        z_mm = volume.middle_mm
        side_mm, _ = volume.half_extents_mm(z_mm)
        along = f"{-pose[5]:.1f} {z_mm - pose[6]:.1f} mm"  # to the middle in y and z
        across = sorted(x for x, _, _ in placed(markers_mm, pose))
        with faulty(dut, f"move tool {part} {-side_mm - OUTSIDE_MM - across[-1]:.1f} {along}"):
            await_frame(unit, lambda frame: frame.handles[0].outside, "status bit 0040")
        edge_mm = (across[-3] + across[-2]) / 2  # two markers inside: fewer than any tool needs
        with faulty(dut, f"move tool {part} {-side_mm - edge_mm:.1f} {along}"):
            frame = await_frame(
                unit,
                lambda frame: bool(frame.handles[0].port_status & PortStatus.PARTIALLY_OUT_OF_VOLUME),
                "status bit 0080",
            )
            check(frame.handles[0].pose is not None, "a transform nevertheless", frame)
        await_pose(unit)


@case("P50e", "fault: more spheres give more strays; sunlight and interference set their bits", needs=NEEDS)
def foreign_light(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, part):
        few = len(seen(unit, 0x1801).strays_mm)
        wanted = few + MORE_STRAYS
        with faulty(dut, f"strays {MORE_STRAYS}"):
            await_frame(unit, lambda f: len(f.strays_mm) >= wanted, f"{wanted} strays", 0x1801)
        for fault in ("reflections 4", "phantoms 40 mm"):
            with faulty(dut, fault):
                await_frame(unit, lambda f: len(f.strays_mm) > few, f"more strays by {fault}", 0x1801)
        with faulty(dut, "sunlight"):
            await_frame(unit, _has(SystemStatus.TOO_MUCH_INFRARED), "system status 0002")
        with faulty(dut, f"interference tool {part}"):
            await_frame(
                unit,
                lambda frame: bool(frame.handles[0].port_status & PortStatus.IR_INTERFERENCE),
                "port status 0200",
            )
        await_pose(unit)


@case("P50f", "fault: a bump withholds poses until the alerts are read, and stays until cleared", needs=NEEDS)
def bumped(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        dut.fault("now: tracker bump")
        frame = await_frame(unit, _has(SystemStatus.DIAGNOSTICS_PENDING), "system status 0100")
        check(_is_missing(frame), "no pose", frame)
        alerts = int(_value(unit, PARAMETER_NEW_ALERTS))
        check(bool(alerts & Alert.BUMP), "alert bit 21", alerts)
        check(_value(unit, PARAMETER_BUMPED) == "1", "bumped", _value(unit, PARAMETER_BUMPED))
        await_pose(unit)
        unit.okay(f"SET:{PARAMETER_BUMP_CLEAR}=1")
        check(_value(unit, PARAMETER_BUMPED) == "0", "the bump cleared")
        _value(unit, PARAMETER_NEW_ALERTS)
        await_pose(unit)


@case(
    "P50g", "fault: a unit that is too cold or too hot reports system status 0200 and no poses", needs=NEEDS
)
def temperature(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        for fault, alert in (("cold", Alert.TOO_COLD), ("hot", Alert.TOO_HOT)):
            with faulty(dut, fault):
                frame = await_frame(unit, _has(SystemStatus.TEMPERATURE), "system status 0200")
                check(_is_missing(frame), "no pose", frame)
                alerts = int(_value(unit, PARAMETER_ALERTS))
                check(bool(alerts & alert), f"the alert {alert.name}", alerts)
            _value(unit, PARAMETER_NEW_ALERTS)
            await_pose(unit)


@case("P50h", "fault: a hardware failure gives system status 0010 and an alert", needs=NEEDS)
def hardware(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        with faulty(dut, f"alert {HARDWARE_ALERT.bit_length() - 1}"):
            await_frame(unit, _has(SystemStatus.HARDWARE_FAILURE), "system status 0010")
            alerts = int(_value(unit, PARAMETER_ALERTS))
            check(bool(alerts & HARDWARE_ALERT), "the alert", alerts)
        _value(unit, PARAMETER_NEW_ALERTS)
        await_pose(unit)


@case("P50i", "fault: plugging and unplugging a wired tool gives system status 0040 and 0080", needs=NEEDS)
def plugged(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        with faulty(dut, f"plug {SOCKET}"):
            await_frame(unit, _has(SystemStatus.PORT_OCCUPIED), "system status 0040")
        await_frame(unit, _has(SystemStatus.PORT_UNOCCUPIED), "system status 0080")


@case("P50j", "fault: a garbled command gives ERROR04", needs=NEEDS)
def garbled_commands(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit, faulty(dut, "garble commands 100 %"):
        found = {unit.ask("APIREV:") for _ in range(GARBLED_COMMANDS)}
        # A flipped bit may hit the name, or make a CRC digit lower case, which is harmless.
        check("ERROR04" in found, "ERROR04", found)


@case("P50k", "fault: garbled, shortened, doubled, cut, lost and late replies", needs=NEEDS)
def disturbed_replies(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        good = with_crc(unit.ask("APIREV:"))
        faults = ("garble replies", "drop bytes", "double bytes", "cut replies", "lose replies")
        for fault in faults:
            with faulty(dut, f"{fault} 100 %"):
                unit.send("APIREV:")
                heard = unit.rest(DELAY_S)
                check(heard != good, f"another reply by {fault}", heard)
                if fault == "lose replies":
                    check(heard == b"", "no reply", heard)
            unit.rest()
            check(with_crc(unit.ask("APIREV:")) == good, f"a whole reply after {fault}")
        with faulty(dut, f"delay replies {DELAY_S} s"):
            began_s = time.monotonic()
            unit.ask("APIREV:")
            check(time.monotonic() - began_s >= DELAY_S, f"a reply after {DELAY_S} s")


@case("P50l", "fault: a unit that restarts sends RESET and needs INIT", needs=NEEDS)
def restarted(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        dut.fault("now: tracker restart")
        reply = unit.text(RESET_LIMIT_S)
        check(reply == REPLY_RESET, "RESET", reply)
        unit.refused("BX:0001", 0x10)
        unit.okay("INIT:")


@case("P50m", "fault: a unit without power is silent and sends RESET when power returns", needs=NEEDS)
def power_cut(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        with faulty(dut, "power off"):
            unit.send("APIREV:")
            check(unit.rest(DELAY_S) == b"", "silence")
        reply = unit.text(RESET_LIMIT_S)
        check(reply == REPLY_RESET, "RESET", reply)
        unit.okay("INIT:")


@case("P50n", "fault: frames are repeated and skipped", needs=NEEDS)
def frames_repeat_and_skip(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        with faulty(dut, "repeat frames"):
            time.sleep(DELAY_S)
            first = seen(unit).frame
            time.sleep(DELAY_S)
            check(seen(unit).frame == first, f"frame {first} again", seen(unit).frame)
        await_frame(unit, lambda frame: frame.frame > first, f"a frame after {first}")
        with faulty(dut, "skip 9 frames"):
            time.sleep(DELAY_S)
            numbers = set()
            until_s = time.monotonic() + 4 * DELAY_S
            while time.monotonic() < until_s:
                numbers.add(seen(unit).frame)
            ordered = sorted(numbers)
            steps = {b - a for a, b in pairwise(ordered)}
            check(bool(steps) and min(steps) >= 10, "steps of 10 and more", steps)


@case("P50o", "fault: a unit whose watchdog has expired stops tracking", needs=NEEDS)
def watchdog(dut: DeviceUnderTest) -> None:
    with tracking(dut) as (unit, _):
        dut.fault("now: tracker watchdog")
        deadline_s = time.monotonic() + SHOWN_WITHIN_S
        while (reply := unit.ask("TX:0001")) not in NOT_TRACKING:
            check(time.monotonic() < deadline_s, " or ".join(NOT_TRACKING), reply)
        unit.rest(DELAY_S)
        unit.okay("INIT:")


@case("P50p", "fault: a corrupt definition is refused at PINIT", needs=NEEDS)
def corrupt_definition(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        with faulty(dut, "corrupt definitions"):
            handle = unit.request_handle()
            unit.write(handle, block)
            unit.refused(f"PINIT:{handle}", 0x13, 0x40, 0x41)
            unit.okay(f"PHF:{handle}")
        unit.load(block)


@case("P50q", "fault: too many tools are refused at PENA, too many handles at PHRQ", needs=NEEDS)
def too_many(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.load(block)
        handle = unit.request_handle()
        unit.write(handle, block)
        reply = unit.ask(f"PINIT:{handle}")
        check(reply == "OKAY" or reply.startswith("WARNING"), "OKAY or WARNING to PINIT", reply)
        with faulty(dut, "allow 1 tools"):
            unit.refused(f"PENA:{handle}D", 0x28)
        unit.okay(f"PENA:{handle}D")
        with faulty(dut, "allow 2 handles"):
            unit.refused("PHRQ:*********1****", 0x2D)
        unit.request_handle()


@case("P50r", "fault: a volume for another wavelength is refused at TSTART", needs=NEEDS)
def wrong_wavelength(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.load(block)
        with faulty(dut, "wrong wavelength"):
            unit.refused("TSTART:80", 0x22)
        unit.okay("TSTART:80")


@case("P50s", "fault: INIT, PINIT and TSTART take longer", needs=NEEDS)
def slow_commands(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        for name in ("INIT", "PINIT", "TSTART"):
            with faulty(dut, f"slow {name} {SLOWER_S} s"):
                handle = unit.request_handle()
                unit.write(handle, block)
                argument = {"PINIT": handle, "TSTART": "80"}.get(name, "")
                began_s = time.monotonic()
                unit.ask(f"{name}:{argument}")
                check(time.monotonic() - began_s >= SLOWER_S, f"{name} takes {SLOWER_S} s longer")
            unit.clean_up()


def _is_missing(frame: Seen) -> bool:
    return all(reading.status is HandleStatus.MISSING for reading in frame.handles)


def _has(status: SystemStatus) -> Callable[[Seen], bool]:
    return lambda frame: bool(frame.system_status & status)


def _value(unit: PolarisLink, name: str) -> str:
    return unit.ask(f"GET:{name}").partition("=")[2].strip()


def _tool_information(unit: PolarisLink) -> tuple[int, list[int]]:
    """Tool information and one digit per marker slot, of the only handle, which is missing."""
    body = unit.binary("BX:0803")
    part = body[-13:-2]
    return part[0], [nibble for byte in part[1:] for nibble in (byte >> 4, byte & 0x0F)]
