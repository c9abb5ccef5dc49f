"""Commands of port handles: PHSR, PHRQ, PHF, PINIT, PENA, PDIS, PHINF, PFSEL."""

from __future__ import annotations

import re

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, HandleQuery, SystemStatus, TrackingPriority
from sim.polaris.handlers.arguments import (
    hexadecimal,
    initialised_port_of,
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

DEFAULT_INFORMATION = "0001"
PRIORITIES = (TrackingPriority.STATIC, TrackingPriority.DYNAMIC, TrackingPriority.BUTTON_BOX)
# Hardware device, system type (Polaris), tool type, port, and what to load: nothing or a dummy.
_description = re.compile(r"[!-~]{8}[*0]([*01])(\*\*|[0-9]{2})(\*\*|00|01|02)")
WIRED = "0"
ANY_PORT, NO_PORT = "**", "00"
DUMMIES = ("01", "02")  # passive or wired, and active wireless
ACTIVE_WIRELESS_DUMMY = "02"


def search(unit: Unit, argument: str) -> str:
    """PHSR oo"""
    option = hexadecimal(argument) if argument else HandleQuery.ALL
    if option not in list(HandleQuery):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    unit.port_changes = SystemStatus(0)  # freeing them is up to the host
    ports = unit.ports.matching(HandleQuery(option))
    return f"{len(ports):02X}" + "".join(f"{port.handle:02X}{int(port.status):03X}" for port in ports)


def request(unit: Unit, argument: str) -> str:
    """PHRQ"""
    asked = _description.fullmatch(argument)
    if asked is None:
        raise Refusal(ErrorCode.BAD_PORT_DESCRIPTION)
    kind, number, load = asked.groups()
    port = _wired(unit, number, load) if kind == WIRED else _wireless(unit, number, load)
    return f"{port.handle:02X}"


def free(unit: Unit, argument: str) -> None:
    """PHF hh"""
    unit.ports.free(port_of(unit, argument).handle)


def initialise(unit: Unit, argument: str) -> str:
    """PINIT hh"""
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


def enable(unit: Unit, argument: str) -> None:
    """PENA hh and priority"""
    priority = argument[HANDLE_DIGITS]
    if priority not in PRIORITIES:
        raise Refusal(ErrorCode.BAD_PRIORITY)
    port = initialised_port_of(unit, argument)
    if not port.enabled and len(unit.ports.enabled()) >= unit.model.enabled_tools:
        raise Refusal(ErrorCode.TOO_MANY_ENABLED)
    port.priority = priority
    port.enabled = True


def disable(unit: Unit, argument: str) -> None:
    """PDIS hh"""
    port = initialised_port_of(unit, argument)
    if not port.enabled:
        raise Refusal(ErrorCode.HANDLE_NOT_ENABLED)
    port.enabled = False


def information(unit: Unit, argument: str) -> str:
    """PHINF hh oooo: the parts of all requested options, lowest bit first."""
    asked = hexadecimal(argument[HANDLE_DIGITS:] or DEFAULT_INFORMATION)
    if not asked or asked & ~sum(PORT_INFORMATION):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    port = port_of(unit, argument)
    if not port.occupied:
        return wire.REPLY_UNOCCUPIED
    return "".join(part(unit, port) for bit, part in PORT_INFORMATION.items() if asked & bit)


def select_faces(unit: Unit, argument: str) -> None:
    """PFSEL hhmm: only these faces are tracked."""
    faces = hexadecimal(argument[HANDLE_DIGITS:])
    if not 0 < faces <= ALL_FACES:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    initialised_port_of(unit, argument).faces = faces


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
    if warning is WarningCode.DEFAULT_WAVELENGTH and not unit.user_parameters.number(RETURN_WARNING):
        return None
    return warning


def _wireless(unit: Unit, number: str, load: str) -> Port:
    if number not in (ANY_PORT, NO_PORT):
        raise Refusal(ErrorCode.BAD_PORT_DESCRIPTION)
    active = load == ACTIVE_WIRELESS_DUMMY
    return unit.ports.request(dummy=load in DUMMIES, active_wireless=active)


def _wired(unit: Unit, number: str, load: str) -> Port:
    """A socket by number, or the first one without a handle."""
    sockets = range(1, unit.wired.count + 1)
    if number == ANY_PORT:
        free_ones = [socket for socket in sockets if unit.ports.of_socket(socket) is None]
        if not free_ones:
            raise Refusal(ErrorCode.PORT_HAS_HANDLE if sockets else ErrorCode.BAD_PORT_DESCRIPTION)
        socket = free_ones[0]
    else:
        socket = int(number)
    if socket not in sockets or load == ACTIVE_WIRELESS_DUMMY:
        raise Refusal(ErrorCode.BAD_PORT_DESCRIPTION)
    return unit.ports.request_wired(socket, unit.wired.tool(socket), dummy=load in DUMMIES)
