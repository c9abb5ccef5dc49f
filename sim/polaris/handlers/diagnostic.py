"""Commands of diagnostic mode: DSTART, DSTOP, IRED, 3D, IRINIT, IRCHK."""

from __future__ import annotations

from ronna_hw.wire.polaris import HANDLE_DIGITS, LF, MAXIMUM_STRAYS
from sim.polaris.handlers.arguments import (
    hexadecimal,
    initialised_port_of,
    wired_port_of,
)
from sim.polaris.unit.alerts import HARDWARE
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

FIRING_DIGITS = 8
EVERYTHING_SEEN = "5"  # the only form of 3D with a public reply
POSITION_SCALE = 10_000  # 3D: four implied decimals
SEPARATION_SCALE = 100  # two implied decimals
LARGEST_SEPARATION = 9999
DETECTED, SOURCES = 0x0001, 0x0002  # options of IRCHK
NO_SOURCES = "000"  # of one sensor, in three digits


def start(unit: Unit, _argument: str) -> None:
    """DSTART"""
    if unit.alerts.current & HARDWARE and not unit.behaviour.starts_with_hardware_fault:
        raise Refusal(ErrorCode.CANNOT_START_DIAGNOSTIC)
    unit.start_diagnostic()


def stop(unit: Unit, _argument: str) -> None:
    """DSTOP"""
    unit.stop()


def fire(unit: Unit, argument: str) -> None:
    """IRED hh and eight digits: one bit per marker to fire."""
    bits = hexadecimal(argument[HANDLE_DIGITS:])
    port = wired_port_of(unit, argument)
    initialised_port_of(unit, argument)
    port.firing = bits


def markers(unit: Unit, argument: str) -> str:
    """3D hh n: every marker in view, whether of a tool or not."""
    if argument[HANDLE_DIGITS] != EVERYTHING_SEEN:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    port = initialised_port_of(unit, argument)
    frame = unit.diagnostic_frame(port)
    seen = [(stray.position_mm, stray.inside) for stray in frame.strays]
    for own, tracked in frame.tools:
        if tracked is not None:
            own_markers = zip(tracked.markers_mm, tracked.markers_inside, strict=True)
            for index, (position, inside) in enumerate(own_markers):
                if position is not None and (not own.wired_port or own.firing >> index & 1):
                    seen.append((position, inside))
    separation = min(round(unit.behaviour.line_separation_mm * SEPARATION_SCALE), LARGEST_SEPARATION)
    records = [
        "".join(f"{round(value * POSITION_SCALE):+09d}" for value in position)
        + f"{separation:04d}{int(not inside)}"
        for position, inside in seen[:MAXIMUM_STRAYS]
    ]
    return LF.join([f"{len(records):03d}", *records])


def prepare_infrared_check(unit: Unit, _argument: str) -> None:
    """IRINIT"""
    unit.infrared_checked = True


def check_infrared(unit: Unit, argument: str) -> str:
    """IRCHK [oooo]: whether there is ambient infrared light, and where."""
    asked = hexadecimal(argument) if argument else DETECTED
    if not asked or asked & ~(DETECTED | SOURCES):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    if not unit.infrared_checked:
        raise Refusal(ErrorCode.INFRARED_CHECK_NOT_READY)
    if unit.measurer.light:
        raise Refusal(ErrorCode.TOO_MUCH_INFRARED)
    detected = "0" if asked & DETECTED else ""
    return detected + (2 * NO_SOURCES if asked & SOURCES else "")
