"""Initialise, enable and describe the tool of a handle: PINIT, PENA, PDIS, PHINF, PFSEL."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, TrackingPriority
from sim.polaris.handlers.arguments import (
    hexadecimal,
    initialised_port_of,
    need_length,
    occupied_port_of,
    port_of,
)
from sim.polaris.handlers.port_information import PORT_INFORMATION
from sim.polaris.tools.definition import BadDefinition, parse_definition
from sim.polaris.tools.geometry_rules import warning_of
from sim.polaris.tools.ports import ALL_FACES, Port
from sim.polaris.unit.refusal import ErrorCode, Refusal, WarningCode
from sim.polaris.unit.unit import Unit
from sim.polaris.unit.user_parameter_table import RETURN_WARNING

OPTION_DIGITS = 4
DEFAULT_INFORMATION = "0001"
PRIORITIES = (TrackingPriority.STATIC, TrackingPriority.DYNAMIC, TrackingPriority.BUTTON_BOX)


def initialise(unit: Unit, argument: str) -> str:
    """PINIT hh"""
    need_length(argument, HANDLE_DIGITS)
    port = occupied_port_of(unit, argument)
    if port.dummy:
        port.initialised = True
        return wire.REPLY_OKAY
    if not port.written:
        raise Refusal(ErrorCode.NO_TOOL)
    _read_definition(unit, port)
    warning = _warning(unit, port)
    port.initialised = True
    if warning is None:
        return wire.REPLY_OKAY
    return f"{wire.REPLY_WARNING}{warning:02X}" if unit.behaviour.warns_with_code else wire.REPLY_WARNING


def enable(unit: Unit, argument: str) -> str:
    """PENA hh and priority"""
    need_length(argument, HANDLE_DIGITS + 1)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    priority = argument[HANDLE_DIGITS]
    if priority not in PRIORITIES:
        raise Refusal(ErrorCode.BAD_PRIORITY)
    port = initialised_port_of(unit, argument)
    if not port.enabled and len(unit.ports.enabled()) >= unit.model.enabled_tools:
        raise Refusal(ErrorCode.TOO_MANY_ENABLED)
    port.priority = priority
    port.enabled = True
    return wire.REPLY_OKAY


def disable(unit: Unit, argument: str) -> str:
    """PDIS hh"""
    need_length(argument, HANDLE_DIGITS)
    port = initialised_port_of(unit, argument)
    if not port.enabled:
        raise Refusal(ErrorCode.HANDLE_NOT_ENABLED)
    port.enabled = False
    return wire.REPLY_OKAY


def information(unit: Unit, argument: str) -> str:
    """PHINF hh oooo: the parts of all requested options, lowest bit first."""
    need_length(argument, HANDLE_DIGITS, HANDLE_DIGITS + OPTION_DIGITS)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    asked = hexadecimal(argument[HANDLE_DIGITS:] or DEFAULT_INFORMATION)
    if not asked or asked & ~sum(PORT_INFORMATION):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    port = port_of(unit, argument)
    if not port.occupied:
        return wire.REPLY_UNOCCUPIED
    return "".join(part(unit, port) for bit, part in PORT_INFORMATION.items() if asked & bit)


def select_faces(unit: Unit, argument: str) -> str:
    """PFSEL hhmm: only these faces are tracked."""
    need_length(argument, 2 * HANDLE_DIGITS)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    faces = hexadecimal(argument[HANDLE_DIGITS:])
    if not 0 < faces <= ALL_FACES:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    initialised_port_of(unit, argument).faces = faces
    return wire.REPLY_OKAY


def _read_definition(unit: Unit, port: Port) -> None:
    behaviour = unit.behaviour
    try:
        port.definition = parse_definition(bytes(port.memory))
    except BadDefinition as bad:
        limits = bad.limits
        raise Refusal(behaviour.definition_beyond_limits if limits else behaviour.bad_definition) from None
    port.place = None
    if not unit.measurer.hangs_on_mount(port):
        port.place = unit.ports.free_place()


def _warning(unit: Unit, port: Port) -> WarningCode | None:
    tool = port.definition
    if tool is None or port.wired_port:  # active markers fire in turn: geometry does not identify them
        return None
    others = [other.definition for other in unit.ports if other is not port and not other.wired_port]
    warning = warning_of(tool, [other for other in others if other is not None], unit.behaviour)
    if warning is WarningCode.DEFAULT_WAVELENGTH and not unit.parameters.number(RETURN_WARNING):
        return None
    return warning
