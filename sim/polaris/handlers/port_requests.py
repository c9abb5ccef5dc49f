"""Commands that list, allocate and free port handles: PHSR, PHRQ, PHF."""

from __future__ import annotations

import re

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, HandleQuery, SystemStatus
from sim.polaris.handlers.arguments import hexadecimal, need_length, port_of
from sim.polaris.tools.ports import Port
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

# Hardware device, system type (Polaris), tool type, port, and what to load: nothing or a dummy.
_description = re.compile(r"[!-~]{8}[*0]([*01])(\*\*|[0-9]{2})(\*\*|00|01|02)")
WIRED = "0"
ANY_PORT, NO_PORT = "**", "00"
DUMMIES = ("01", "02")  # passive or wired, and active wireless
ACTIVE_WIRELESS_DUMMY = "02"


def search(unit: Unit, argument: str) -> str:
    """PHSR oo"""
    need_length(argument, 0, 2)
    option = hexadecimal(argument) if argument else HandleQuery.ALL
    if option not in list(HandleQuery):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    unit.port_changes = SystemStatus(0)  # freeing them is up to the host
    ports = unit.ports.matching(HandleQuery(option))
    return f"{len(ports):02X}" + "".join(f"{port.handle:02X}{int(port.status):03X}" for port in ports)


def request(unit: Unit, argument: str) -> str:
    """PHRQ"""
    need_length(argument, wire.PHRQ_ARGUMENT_CHARACTERS)
    asked = _description.fullmatch(argument)
    if asked is None:
        raise Refusal(ErrorCode.BAD_PORT_DESCRIPTION)
    kind, number, load = asked.groups()
    port = _wired(unit, number, load) if kind == WIRED else _wireless(unit, number, load)
    return f"{port.handle:02X}"


def free(unit: Unit, argument: str) -> str:
    """PHF hh"""
    need_length(argument, HANDLE_DIGITS)
    unit.ports.free(port_of(unit, argument).handle)
    return wire.REPLY_OKAY


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
