"""Checklist lines 1 to 10: the line, the forms of commands and replies, the first commands."""

from __future__ import annotations

import time

from conformance.case import DESTRUCTIVE, CaseList, NotShown, check
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.link import (
    FAST_ARGUMENT,
    FAST_BAUD,
    RESET_LIMIT_S,
    idle_unit,
    is_error,
    with_crc,
)
from conformance.polaris.suite import NEEDS, SERIAL
from ronna_hw.wire.polaris import DEFAULT_BAUD, REPLY_RESET

QUICK_INIT_S = 0.15  # if slower, a client that probes for 200 ms sends a break
INIT_LIMIT_S = 4.0  # the unit's own
INITS = 5
RESET_SETTLING_S = 0.2

CASES = CaseList()
case = CASES.case


@case("P01", "after a break the unit sends RESET at 9600 baud, 8N1", needs=(*SERIAL, DESTRUCTIVE))
def break_resets(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        try:
            unit.go_to(FAST_ARGUMENT, FAST_BAUD)
            check(not is_error(unit.ask("APIREV:")), f"a reply at {FAST_BAUD} baud")
            unit.serial.send_break()
        finally:
            unit.serial.baud = DEFAULT_BAUD
        reply = unit.text(RESET_LIMIT_S)
        check(reply == REPLY_RESET, "RESET after a break", reply)
        unit.refused("PHSR:00", 0x10)
        unit.okay("INIT:")


@case("P01b", "RESET 0 works like a break: the unit sends RESET and needs INIT", needs=(*NEEDS, DESTRUCTIVE))
def reset_command(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        unit.send("RESET:0")
        reply = unit.text(RESET_LIMIT_S)
        check(reply == REPLY_RESET, "RESET", reply)
        time.sleep(RESET_SETTLING_S)
        unit.refused("PHSR:00", 0x10)
        unit.okay("INIT:")


@case("P02", "every text reply ends in four upper-case hex digits of CRC and CR", needs=NEEDS)
def replies_carry_a_crc(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        for command in ("APIREV:", "VER:4", "VER:0", "PHSR:00", "GET:Features.Firmware.Version"):
            unit.ask(command)


@case("P03", "a command with a wrong CRC returns ERROR04 and has no effect", needs=NEEDS)
def wrong_crc_has_no_effect(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        good = with_crc("PHRQ:*********1****")
        unit.refused(good[:-2] + (b"0" if good[-2:-1] != b"0" else b"1") + b"\r", 0x04)
        check(unit.handles() == [], "no handle allocated", unit.handles())


@case("P04", "a command with a space needs no CRC; its reply has one", needs=NEEDS)
def space_form(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        check(unit.ask(b"APIREV \r") == unit.ask("APIREV:"), "the same reply in both forms")


@case("P05", "INIT without any separator is accepted", needs=NEEDS)
def bare_init(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        unit.okay(b"INIT\r")


@case("P06", "an unknown command returns ERROR01", needs=NEEDS)
def unknown_command(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        unit.refused("XYZZY:", 0x01)


@case("P07", "a command that arrives byte by byte is accepted", needs=NEEDS)
def byte_by_byte(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        for byte in with_crc("APIREV:"):
            unit.send(bytes([byte]))
            time.sleep(0.002)
        check(not is_error(unit.text()), "the reply to APIREV")


@case("P08", "OKAY to COMM comes at the old baud rate, then the unit uses the new one", needs=SERIAL)
def rate_changes_after_the_answer(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        about = unit.ask("APIREV:")
        with unit.hurried():
            check(unit.ask("APIREV:") == about, f"the same reply at {FAST_BAUD} baud")
        check(unit.ask("APIREV:") == about, f"the same reply at {DEFAULT_BAUD} baud again")


@case(
    "P09",
    "before INIT, commands about tools and tracking return ERROR10",
    needs=(*NEEDS, DESTRUCTIVE),
)
def set_up_before_init(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        unit.send("RESET:0")
        unit.text(RESET_LIMIT_S)
        time.sleep(RESET_SETTLING_S)
        for command in ("PHSR:00", "PHRQ:*********1****", "SFLIST:03", "TSTART:80", "TSTOP:", "BX:0001"):
            unit.refused(command, 0x10)
        unit.okay("INIT:")
        check(unit.handles() == [], "no handles after INIT", unit.handles())


@case("P10", "INIT is answered within 150 ms, before a probing client sends a break", needs=NEEDS)
def init_is_quick(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        took_s = []
        for _ in range(INITS):
            began_s = time.monotonic()
            unit.okay("INIT:")
            took_s.append(time.monotonic() - began_s)
        quickest_s = min(took_s)
        check(
            quickest_s <= INIT_LIMIT_S, f"a reply within the unit's limit of {INIT_LIMIT_S:g} s", quickest_s
        )
        if quickest_s > QUICK_INIT_S:
            raise NotShown(
                f"INIT takes {quickest_s:.2f} s: allowed, but a client that probes for 200 ms sends a break"
            )
