"""Port handle commands: PHSR, PHRQ, PHF, PINIT, PENA, PDIS, PHINF, PFSEL.

Before PINIT, PHINF knows the port status only.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from types import MappingProxyType
from typing import Literal

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS, HandleQuery, SystemStatus, TrackingPriority
from ronna_hw.wire.polaris_rom import PART_NUMBER_BYTES
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.ports import ALL_FACES, Port
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, WarningCode, hexadecimal
from sim.polaris.unit.tool_definition import BadDefinition, parse_definition, warning_of
from sim.polaris.unit.user_parameters import RETURN_WARNING

SERIAL_BYTES = 4
MANUFACTURER_CHARACTERS = 12
NO_SWITCHES_NO_LEDS = "00"
RESERVED = "00"
NO_ACCESSORIES = "00"
LONGEST_REVISION = 999
DEVICE_CHARACTERS = 8
SYSTEM_POLARIS, TOOL_WIRED, TOOL_WIRELESS, CHANNEL = "0", "0", "1", "00"
NO_OUTPUTS = "00"  # only on Aurora
PORT_STATUS_BYTE = 0xFF
# Tool-in-port diode, switches 1 to 3, tracking LED, visible LEDs 1 to 3.
ACCESSORY_BITS = (0x01, 0x02, 0x04, 0x08, 0x10, 0x20, 0x40, 0x80)

DEFAULT_INFORMATION = "0001"
PRIORITIES = (TrackingPriority.STATIC, TrackingPriority.DYNAMIC, TrackingPriority.BUTTON_BOX)

# Hardware device, system type (Polaris), tool type, port, and whether to load a dummy.
_PORT_DESCRIPTION = re.compile(r"[!-~]{8}[*0]([*01])(\*\*|[0-9]{2})(\*\*|00|01|02)")
WIRED = "0"
ANY_PORT, NO_PORT = "**", "00"
DUMMIES = ("01", "02")  # passive or wired, and active wireless
ACTIVE_WIRELESS_DUMMY = "02"


def search(unit: SimulatedUnit, argument: str) -> str:
    """PHSR oo"""
    option = hexadecimal(argument) if argument else HandleQuery.ALL
    if option not in list(HandleQuery):
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    unit.port_changes = SystemStatus(0)  # the host knows them now
    ports = unit.ports.list_matching(HandleQuery(option))
    return f"{len(ports):02X}" + "".join(f"{port.handle:02X}{int(port.status):03X}" for port in ports)


def request(unit: SimulatedUnit, argument: str) -> str:
    """PHRQ"""
    requested_port = _PORT_DESCRIPTION.fullmatch(argument)
    if requested_port is None:
        raise CommandRefusal(NdiErrorCode.BAD_PORT_DESCRIPTION)
    kind, number, load = requested_port.groups()
    port = _request_wired(unit, number, load) if kind == WIRED else _request_wireless(unit, number, load)
    return f"{port.handle:02X}"


def free(unit: SimulatedUnit, argument: str) -> None:
    """PHF hh"""
    unit.ports.free(unit.ports.require_port(argument).handle)


def initialise(unit: SimulatedUnit, argument: str) -> str:
    """PINIT hh"""
    port = unit.ports.require_occupied(argument)
    if port.dummy:
        port.initialised = True
        return wire.REPLY_OKAY
    if not port.written:
        raise CommandRefusal(NdiErrorCode.NO_TOOL)
    _read_definition(unit, port)
    warning = _find_warning(unit, port)
    port.initialised = True
    if warning is None:
        return wire.REPLY_OKAY
    return f"{wire.REPLY_WARNING}{warning:02X}" if unit.behaviour.warns_with_code else wire.REPLY_WARNING


def enable(unit: SimulatedUnit, argument: str) -> None:
    """PENA hh p: enable with a priority"""
    priority = argument[HANDLE_DIGITS]
    if priority not in PRIORITIES:
        raise CommandRefusal(NdiErrorCode.BAD_PRIORITY)
    port = unit.ports.require_initialised(argument)
    if not port.enabled and len(unit.ports.enabled()) >= unit.model.enabled_tools:
        raise CommandRefusal(NdiErrorCode.TOO_MANY_ENABLED)
    port.priority = priority
    port.enabled = True


def disable(unit: SimulatedUnit, argument: str) -> None:
    """PDIS hh"""
    port = unit.ports.require_initialised(argument)
    if not port.enabled:
        raise CommandRefusal(NdiErrorCode.HANDLE_NOT_ENABLED)
    port.enabled = False


def information(unit: SimulatedUnit, argument: str) -> str:
    """PHINF hh oooo: all requested parts, lowest option bit first"""
    requested_port = hexadecimal(argument[HANDLE_DIGITS:] or DEFAULT_INFORMATION)
    if not requested_port or requested_port & ~sum(PORT_INFORMATION):
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    port = unit.ports.require_port(argument)
    if not port.occupied:
        return wire.REPLY_UNOCCUPIED
    return "".join(part(unit, port) for bit, part in PORT_INFORMATION.items() if requested_port & bit)


def select_faces(unit: SimulatedUnit, argument: str) -> None:
    """PFSEL hhmm: track only the selected faces"""
    faces = hexadecimal(argument[HANDLE_DIGITS:])
    if not 0 < faces <= ALL_FACES:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    unit.ports.require_initialised(argument).faces = faces


def _read_definition(unit: SimulatedUnit, port: Port) -> None:
    behaviour = unit.behaviour
    try:
        port.definition = parse_definition(bytes(port.memory))
    except BadDefinition as bad:
        limits = bad.limits
        raise CommandRefusal(
            behaviour.definition_beyond_limits if limits else behaviour.bad_definition
        ) from None
    port.place = None
    if not unit.measurer.is_mount_frame(port):
        port.place = unit.ports.free_place()


def _find_warning(unit: SimulatedUnit, port: Port) -> WarningCode | None:
    tool = port.definition
    if tool is None or port.wired_port:  # active markers fire in turn: geometry does not identify them
        return None
    others = [other.definition for other in unit.ports if other is not port and not other.wired_port]
    warning = warning_of(tool, [other for other in others if other is not None], unit.behaviour)
    if warning is WarningCode.DEFAULT_WAVELENGTH and not unit.user_parameters.number(RETURN_WARNING):
        return None
    return warning


def _request_wireless(unit: SimulatedUnit, number: str, load: str) -> Port:
    if number not in (ANY_PORT, NO_PORT):
        raise CommandRefusal(NdiErrorCode.BAD_PORT_DESCRIPTION)
    active = load == ACTIVE_WIRELESS_DUMMY
    return unit.ports.request(dummy=load in DUMMIES, active_wireless=active)


def _request_wired(unit: SimulatedUnit, number: str, load: str) -> Port:
    """Allocate a handle for the numbered socket, or for the first socket without a handle."""
    sockets = range(1, unit.wired.count + 1)
    if number == ANY_PORT:
        free_ones = [socket for socket in sockets if unit.ports.find_by_socket(socket) is None]
        if not free_ones:
            raise CommandRefusal(
                NdiErrorCode.PORT_HAS_HANDLE if sockets else NdiErrorCode.BAD_PORT_DESCRIPTION
            )
        socket = free_ones[0]
    else:
        socket = int(number)
    if socket not in sockets or load == ACTIVE_WIRELESS_DUMMY:
        raise CommandRefusal(NdiErrorCode.BAD_PORT_DESCRIPTION)
    return unit.ports.request_wired(socket, unit.wired.tool(socket), dummy=load in DUMMIES)


def _tool_information(unit: SimulatedUnit, port: Port) -> str:
    tool = port.definition
    status = f"{int(port.status) & PORT_STATUS_BYTE:02X}"
    if tool is None:
        return f"00{NO_SWITCHES_NO_LEDS}{RESERVED}00{'':12}{'000'}{'00000000'}{status}"
    maker = tool.manufacturer[:MANUFACTURER_CHARACTERS].ljust(MANUFACTURER_CHARACTERS)
    revision = f"{min(tool.revision, LONGEST_REVISION):03d}"
    counts = f"{sum(tool.switches)}{sum(tool.lit)}" if port.wired_port else NO_SWITCHES_NO_LEDS
    kind = f"{tool.main_type:02X}{counts}{RESERVED}{tool.subtype:02X}"
    order: Literal["big", "little"] = "big" if unit.behaviour.serial_low_byte_first else "little"
    serial = tool.serial.to_bytes(SERIAL_BYTES, order).hex().upper()
    return f"{kind}{maker}{revision}{serial}{status}"


def _part_number(_unit: SimulatedUnit, port: Port) -> str:
    number = port.definition.part_number if port.definition else ""
    return number[:PART_NUMBER_BYTES].ljust(PART_NUMBER_BYTES)


def _accessories(unit: SimulatedUnit, port: Port) -> str:
    tool = port.definition
    if tool is None or not (port.wired_port or unit.behaviour.accessories_of_passive):
        return NO_ACCESSORIES
    fitted = (tool.in_port, *tool.switches, tool.tracking_led, *tool.lit)
    return f"{sum(bit for bit, has in zip(ACCESSORY_BITS, fitted, strict=True) if has):02X}"


def _location(unit: SimulatedUnit, port: Port) -> str:
    device = unit.model.serial_number[:DEVICE_CHARACTERS].ljust(DEVICE_CHARACTERS)
    tool_type = TOOL_WIRED if port.wired_port else TOOL_WIRELESS
    return f"{device}{SYSTEM_POLARIS}{tool_type}{port.wired_port:02d}{CHANNEL}"


PORT_INFORMATION: MappingProxyType[int, Callable[[SimulatedUnit, Port], str]] = MappingProxyType(
    {
        0x0001: _tool_information,
        0x0002: lambda _unit, port: f"{port.current_test:08X}",
        0x0004: _part_number,
        0x0008: _accessories,
        0x0010: lambda _unit, port: f"{port.definition.marker_type if port.definition else 0:02X}",
        0x0020: _location,
        0x0040: lambda _unit, _port: NO_OUTPUTS,
    }
)
