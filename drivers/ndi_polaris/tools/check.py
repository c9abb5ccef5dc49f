"""Verifies by PHINF that a handle has the tool whose definition was sent to it."""

from __future__ import annotations

from drivers.ndi_polaris.errors import ForeignTool, UnitError
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.rom.definition import ToolDefinition, encode_definition
from ronna_hw.wire.polaris_rom import SERIAL_OFFSET

# PHINF 0005: tool information (33 characters), then part number (20).
TOOL_AND_PART_NUMBER = "0005"
SERIAL = slice(23, 31)
PART_NUMBER = slice(33, 53)


def check_handle(
    link: CommandLink, handle: int, name: str, definition: ToolDefinition, deadline_s: float
) -> str | None:
    """A notice if serial or part number differs; raises NDI-013 if both do.

    Either byte order of the serial number is accepted, since firmware differs. A unit
    without PHINF is trusted.
    """
    try:
        text = link.ask("PHINF", f"{handle:02X}{TOOL_AND_PART_NUMBER}", deadline_s=deadline_s)
    except UnitError:
        return None
    serial, part_number = text[SERIAL].upper(), text[PART_NUMBER].strip()
    sent = encode_definition(definition)[SERIAL_OFFSET : SERIAL_OFFSET + 4]
    same_serial = serial in (sent.hex().upper(), sent[::-1].hex().upper())
    same_part_number = part_number == definition.part_number
    if same_serial and same_part_number:
        return None
    expected = f"part number {definition.part_number}, serial number {sent[::-1].hex().upper()}"
    reported = f"part number {part_number or '-'}, serial number {serial or '-'}"
    if not same_serial and not same_part_number:
        raise ForeignTool(
            f"handle {handle:02X} holds another tool than {name}", expected=expected, got=reported
        )
    return f"{name}: the unit reports {reported}, the definition has {expected}"
