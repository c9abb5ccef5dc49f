"""Measurement commands: TSTART, TSTOP, TX, BX; in diagnostic mode DSTART, DSTOP, IRED, 3D, IRINIT, IRCHK."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, LF, MAXIMUM_STRAYS, ReplyOption
from sim.polaris.handlers.frame_replies import binary_body, text_reply
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.framing import ascii_reply, binary_reply
from sim.polaris.unit.ports import Port
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, hexadecimal
from sim.polaris.unit.tool_definition import wavelength_of
from sim.polaris.unit.user_parameters import HARDWARE_ALERTS

RESTART_COUNTER = int(wire.TSTART_RESET_FRAME_COUNTER, 16)
START_OPTIONS = RESTART_COUNTER | int(wire.TSTART_FASTER, 16)
OPTIONS = int(sum(ReplyOption))

FIRING_DIGITS = 8
EVERYTHING_SEEN = "5"  # the only form of 3D with a public reply
POSITION_SCALE = 10_000  # 3D: four implied decimals
SEPARATION_SCALE = 100  # two implied decimals
LARGEST_SEPARATION = 9999
DETECTED, SOURCES = 0x0001, 0x0002  # options of IRCHK
NO_SOURCES = "000"  # three digits per sensor


def start(unit: SimulatedUnit, argument: str) -> None:
    """TSTART [nn]"""
    options = hexadecimal(argument) if argument else 0
    if options & ~START_OPTIONS:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    enabled = unit.ports.enabled()
    faulty = unit.alerts.current & HARDWARE_ALERTS and not unit.behaviour.starts_with_hardware_fault
    idle = not enabled and not unit.behaviour.starts_without_tools
    if faulty or idle or _has_dummy_beside_tool(enabled):
        raise CommandRefusal(NdiErrorCode.CANNOT_START_TRACKING)
    if len(enabled) > unit.behaviour.most_tracked:
        raise CommandRefusal(NdiErrorCode.TOO_MANY_ENABLED)
    supported = unit.behaviour.supported_wavelengths
    if any(port.definition and str(wavelength_of(port.definition)) not in supported for port in enabled):
        raise CommandRefusal(NdiErrorCode.WAVELENGTH)
    unit.start_tracking(restart=bool(options & RESTART_COUNTER))


def start_diagnostic(unit: SimulatedUnit, _argument: str) -> None:
    """DSTART"""
    if unit.alerts.current & HARDWARE_ALERTS and not unit.behaviour.starts_with_hardware_fault:
        raise CommandRefusal(NdiErrorCode.CANNOT_START_DIAGNOSTIC)
    unit.start_diagnostic()


def stop(unit: SimulatedUnit, _argument: str) -> None:
    """TSTOP, DSTOP"""
    unit.stop()


def text_frame(unit: SimulatedUnit, argument: str) -> bytes:
    """TX [oooo]"""
    options = _parse_options(argument)
    if options & ReplyOption.TOOL_MARKERS and not unit.behaviour.text_tool_markers:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    return ascii_reply(text_reply(unit.frame(), options, unit.behaviour))


def binary_frame(unit: SimulatedUnit, argument: str) -> bytes:
    """BX [oooo]"""
    options = _parse_options(argument)
    return binary_reply(binary_body(unit.frame(), options, unit.behaviour))


def _parse_options(argument: str) -> int:
    requested_options = hexadecimal(argument) if argument else ReplyOption.TRANSFORMS.value
    if not requested_options or requested_options & ~OPTIONS:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    return requested_options


def _has_dummy_beside_tool(ports: tuple[Port, ...]) -> bool:
    """Return whether a dummy and a real tool of the same type are both enabled."""
    dummies = {(bool(port.wired_port), port.active_wireless) for port in ports if port.dummy}
    return any((bool(port.wired_port), port.active_wireless) in dummies for port in ports if not port.dummy)


def fire(unit: SimulatedUnit, argument: str) -> None:
    """IRED hh bbbbbbbb: one bit per marker to fire"""
    bits = hexadecimal(argument[HANDLE_DIGITS:])
    port = unit.ports.require_wired(argument)
    unit.ports.require_initialised(argument)
    port.firing = bits


def markers(unit: SimulatedUnit, argument: str) -> str:
    """3D hh n: all markers in view, tool or stray"""
    if argument[HANDLE_DIGITS] != EVERYTHING_SEEN:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    port = unit.ports.require_initialised(argument)
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


def prepare_infrared_check(unit: SimulatedUnit, _argument: str) -> None:
    """IRINIT"""
    unit.infrared_checked = True


def check_infrared(unit: SimulatedUnit, argument: str) -> str:
    """IRCHK [oooo]: presence and location of ambient infrared light"""
    requested_options = hexadecimal(argument) if argument else DETECTED
    if not requested_options or requested_options & ~(DETECTED | SOURCES):
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    if not unit.infrared_checked:
        raise CommandRefusal(NdiErrorCode.INFRARED_CHECK_NOT_READY)
    if unit.measurer.light:
        raise CommandRefusal(NdiErrorCode.TOO_MUCH_INFRARED)
    detected = "0" if requested_options & DETECTED else ""
    return detected + (2 * NO_SOURCES if requested_options & SOURCES else "")
