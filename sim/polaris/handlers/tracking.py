"""Tracking: TSTART, TSTOP, TX, BX."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import ReplyOption
from sim.polaris.handlers.arguments import hexadecimal
from sim.polaris.line.framing import ascii_reply, binary_reply
from sim.polaris.replies.bx import binary_body
from sim.polaris.replies.tx import text_reply
from sim.polaris.tools.geometry_rules import wavelength_of
from sim.polaris.tools.ports import Port
from sim.polaris.unit.alerts import HARDWARE
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

RESTART_COUNTER = int(wire.TSTART_RESET_FRAME_COUNTER, 16)
START_OPTIONS = RESTART_COUNTER | int(wire.TSTART_FASTER, 16)
OPTIONS = int(sum(ReplyOption))


def start(unit: Unit, argument: str) -> None:
    """TSTART [nn]"""
    options = hexadecimal(argument) if argument else 0
    if options & ~START_OPTIONS:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    enabled = unit.ports.enabled()
    faulty = unit.alerts.current & HARDWARE and not unit.behaviour.starts_with_hardware_fault
    idle = not enabled and not unit.behaviour.starts_without_tools
    if faulty or idle or _dummy_beside_tool(enabled):
        raise Refusal(ErrorCode.CANNOT_START_TRACKING)
    if len(enabled) > unit.behaviour.most_tracked:
        raise Refusal(ErrorCode.TOO_MANY_ENABLED)
    supported = unit.behaviour.supported_wavelengths
    if any(port.definition and str(wavelength_of(port.definition)) not in supported for port in enabled):
        raise Refusal(ErrorCode.WAVELENGTH)
    unit.start_tracking(restart=bool(options & RESTART_COUNTER))


def stop(unit: Unit, _argument: str) -> None:
    """TSTOP"""
    unit.stop()


def text_frame(unit: Unit, argument: str) -> bytes:
    """TX [oooo]"""
    options = _options(argument)
    if options & ReplyOption.TOOL_MARKERS and not unit.behaviour.text_tool_markers:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    return ascii_reply(text_reply(unit.frame(), options, unit.behaviour))


def binary_frame(unit: Unit, argument: str) -> bytes:
    """BX [oooo]"""
    options = _options(argument)
    return binary_reply(binary_body(unit.frame(), options, unit.behaviour))


def _options(argument: str) -> ReplyOption:
    asked = hexadecimal(argument) if argument else int(ReplyOption.TRANSFORMS)
    if not asked or asked & ~OPTIONS:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    return ReplyOption(asked)


def _dummy_beside_tool(ports: tuple[Port, ...]) -> bool:
    """Whether a dummy and a real tool of one type are both enabled."""
    dummies = {(bool(port.wired_port), port.active_wireless) for port in ports if port.dummy}
    return any((bool(port.wired_port), port.active_wireless) in dummies for port in ports if not port.dummy)
