"""The parts of the reply to PHINF. Before PINIT only the port status is known."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Literal

from ronna_hw.wire.polaris_rom import PART_NUMBER_BYTES
from sim.polaris.tools.ports import Port
from sim.polaris.unit.unit import Unit

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


def _tool_information(unit: Unit, port: Port) -> str:
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


def _current_test(_unit: Unit, port: Port) -> str:
    return f"{port.current_test:08X}"


def _part_number(_unit: Unit, port: Port) -> str:
    number = port.definition.part_number if port.definition else ""
    return number[:PART_NUMBER_BYTES].ljust(PART_NUMBER_BYTES)


def _accessories(unit: Unit, port: Port) -> str:
    tool = port.definition
    if tool is None or not (port.wired_port or unit.behaviour.accessories_of_passive):
        return NO_ACCESSORIES
    fitted = (tool.in_port, *tool.switches, tool.tracking_led, *tool.lit)
    return f"{sum(bit for bit, has in zip(ACCESSORY_BITS, fitted, strict=True) if has):02X}"


def _marker_type(_unit: Unit, port: Port) -> str:
    return f"{port.definition.marker_type if port.definition else 0:02X}"


def _location(unit: Unit, port: Port) -> str:
    device = unit.model.serial_number[:DEVICE_CHARACTERS].ljust(DEVICE_CHARACTERS)
    tool_type = TOOL_WIRED if port.wired_port else TOOL_WIRELESS
    return f"{device}{SYSTEM_POLARIS}{tool_type}{port.wired_port:02d}{CHANNEL}"


def _outputs(_unit: Unit, _port: Port) -> str:
    return NO_OUTPUTS


PORT_INFORMATION: MappingProxyType[int, Callable[[Unit, Port], str]] = MappingProxyType(
    {
        0x0001: _tool_information,
        0x0002: _current_test,
        0x0004: _part_number,
        0x0008: _accessories,
        0x0010: _marker_type,
        0x0020: _location,
        0x0040: _outputs,
    }
)
