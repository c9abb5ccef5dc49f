"""The parts of the answer to PHINF. Before PINIT the unit knows only the status of the handle."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType

from ronna_hw.wire.polaris_rom import PART_NUMBER_BYTES
from sim.polaris.ports import Port
from sim.polaris.unit import Unit

MANUFACTURER_CHARACTERS = 12
NO_SWITCHES_NO_LEDS = "00"
RESERVED = "00"
NO_CURRENT_TEST = "00000000"
NO_ACCESSORIES = "00"
LONGEST_REVISION = 999
DEVICE_CHARACTERS = 8
SYSTEM_POLARIS, TOOL_WIRELESS, PORT_WIRELESS, CHANNEL = "0", "1", "00", "00"


def _tool_information(_unit: Unit, port: Port) -> str:
    tool = port.definition
    status = f"{int(port.status):02X}"
    if tool is None:
        return f"00{NO_SWITCHES_NO_LEDS}{RESERVED}00{'':12}{'000'}{'00000000'}{status}"
    maker = tool.manufacturer[:MANUFACTURER_CHARACTERS].ljust(MANUFACTURER_CHARACTERS)
    revision = f"{min(tool.revision, LONGEST_REVISION):03d}"
    kind = f"{tool.main_type:02X}{NO_SWITCHES_NO_LEDS}{RESERVED}{tool.subtype:02X}"
    return f"{kind}{maker}{revision}{tool.serial:08X}{status}"


def _current_test(_unit: Unit, _port: Port) -> str:
    return NO_CURRENT_TEST


def _part_number(_unit: Unit, port: Port) -> str:
    number = port.definition.part_number if port.definition else ""
    return number[:PART_NUMBER_BYTES].ljust(PART_NUMBER_BYTES)


def _accessories(_unit: Unit, _port: Port) -> str:
    return NO_ACCESSORIES


def _marker_type(_unit: Unit, port: Port) -> str:
    return f"{port.definition.marker_type if port.definition else 0:02X}"


def _location(unit: Unit, _port: Port) -> str:
    device = unit.profile.serial_number[:DEVICE_CHARACTERS].ljust(DEVICE_CHARACTERS)
    return f"{device}{SYSTEM_POLARIS}{TOOL_WIRELESS}{PORT_WIRELESS}{CHANNEL}"


PORT_INFORMATION: MappingProxyType[int, Callable[[Unit, Port], str]] = MappingProxyType(
    {
        0x0001: _tool_information,
        0x0002: _current_test,
        0x0004: _part_number,
        0x0008: _accessories,
        0x0010: _marker_type,
        0x0020: _location,
    }
)
