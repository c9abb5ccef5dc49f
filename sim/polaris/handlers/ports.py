"""Commands about port handles: PHSR, PHRQ, PHF, PVWR, PINIT, PENA, PDIS, PHINF."""

from __future__ import annotations

import re

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, HandleQuery, TrackingPriority
from sim.polaris.definition import BadDefinition, parse_definition
from sim.polaris.handlers.arguments import hexadecimal, need_length, port_of
from sim.polaris.handlers.port_information import PORT_INFORMATION
from sim.polaris.refusal import ErrorCode, Refusal
from sim.polaris.unit import Unit

ADDRESS_DIGITS = 4
BLOCK_DIGITS = 2 * wire.PVWR_BLOCK_BYTES
OPTION_DIGITS = 4
DEFAULT_INFORMATION = "0001"
PRIORITIES = (TrackingPriority.STATIC, TrackingPriority.DYNAMIC, TrackingPriority.BUTTON_BOX)

# device, system type (Polaris), tool type (wireless), port, what to load: nothing or the passive dummy
_passive_port = re.compile(r"[!-~]{8}[*0][*1](\*\*|00)(\*\*|00|01)")
DUMMY = "01"


def search(unit: Unit, argument: str) -> str:
    """PHSR oo"""
    need_length(argument, 0, 2)
    option = hexadecimal(argument) if argument else HandleQuery.ALL
    if option not in list(HandleQuery):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    ports = unit.ports.matching(HandleQuery(option))
    return f"{len(ports):02X}" + "".join(f"{port.handle:02X}{int(port.status):03X}" for port in ports)


def request(unit: Unit, argument: str) -> str:
    """PHRQ, for passive tools"""
    need_length(argument, wire.PHRQ_ARGUMENT_CHARACTERS)
    asked = _passive_port.fullmatch(argument)
    if asked is None:
        raise Refusal(ErrorCode.BAD_PORT_DESCRIPTION)
    return f"{unit.ports.request(dummy=asked[2] == DUMMY).handle:02X}"


def free(unit: Unit, argument: str) -> str:
    """PHF hh"""
    need_length(argument, HANDLE_DIGITS)
    unit.ports.free(port_of(unit, argument).handle)
    return wire.REPLY_OKAY


def write_memory(unit: Unit, argument: str) -> str:
    """PVWR hh aaaa and 64 bytes: what they say is judged by PINIT."""
    need_length(argument, HANDLE_DIGITS + ADDRESS_DIGITS + BLOCK_DIGITS)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    address = hexadecimal(argument[HANDLE_DIGITS : HANDLE_DIGITS + ADDRESS_DIGITS])
    content = argument[HANDLE_DIGITS + ADDRESS_DIGITS :]
    hexadecimal(content)
    if address % wire.PVWR_BLOCK_BYTES or address + wire.PVWR_BLOCK_BYTES > wire.PVWR_SPACE_BYTES:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    port = port_of(unit, argument)
    if port.dummy:
        raise Refusal(ErrorCode.NOT_FOR_THIS_DEVICE)
    port.memory[address : address + wire.PVWR_BLOCK_BYTES] = bytes.fromhex(content)
    port.written = True
    return wire.REPLY_OKAY


def initialise(unit: Unit, argument: str) -> str:
    """PINIT hh"""
    need_length(argument, HANDLE_DIGITS)
    port = port_of(unit, argument)
    if port.initialised:
        return wire.REPLY_OKAY
    if not port.dummy:
        if not port.written:
            raise Refusal(ErrorCode.NO_TOOL)
        try:
            port.definition = parse_definition(bytes(port.memory))
        except BadDefinition:
            raise Refusal(unit.profile.bad_definition) from None
        if not unit.measurer.hangs_on_mount(port):
            port.place = unit.ports.free_place()
    port.initialised = True
    return wire.REPLY_OKAY


def enable(unit: Unit, argument: str) -> str:
    """PENA hh and priority"""
    need_length(argument, HANDLE_DIGITS + 1)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    if argument[HANDLE_DIGITS] not in PRIORITIES:
        raise Refusal(ErrorCode.BAD_PRIORITY)
    port = port_of(unit, argument)
    if not port.initialised:
        raise Refusal(ErrorCode.HANDLE_NOT_INITIALISED)
    if not port.enabled and len(unit.ports.enabled()) >= unit.profile.enabled_tools:
        raise Refusal(ErrorCode.TOO_MANY_ENABLED)
    port.enabled = True
    return wire.REPLY_OKAY


def disable(unit: Unit, argument: str) -> str:
    """PDIS hh"""
    need_length(argument, HANDLE_DIGITS)
    port = port_of(unit, argument)
    if not port.initialised:
        raise Refusal(ErrorCode.HANDLE_NOT_INITIALISED)
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
    return "".join(part(unit, port) for bit, part in PORT_INFORMATION.items() if asked & bit)
