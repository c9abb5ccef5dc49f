"""Loading of tools into the unit: port handle, definition, verification by PHINF."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

from drivers.ndi_polaris.command_link import CommandLink, warning_meaning
from drivers.ndi_polaris.errors import (
    FOREIGN_TOOL,
    BadReplyCrc,
    HandleRefused,
    MalformedReply,
    NoReply,
    UnitError,
)
from drivers.ndi_polaris.options import ToolOption
from drivers.ndi_polaris.tool_definition import ToolDefinition, encode_definition
from ronna_hw.wire import polaris as ndi
from ronna_hw.wire.polaris import HandleQuery, PortStatus, TrackingPriority
from ronna_hw.wire.polaris_rom import SERIAL_OFFSET

PHSR_STATUS_DIGITS = 3
PHSR_BYTES = 2048  # more than 255 handles of five digits each
# PHINF 0005: tool information (33 characters), then part number (20).
TOOL_AND_PART_NUMBER = "0005"
SERIAL = slice(23, 31)
PART_NUMBER = slice(33, 53)


@dataclass(frozen=True)
class LoadedTool:
    """Tool loaded under a port handle; the dummy tool has neither name nor definition."""

    handle: int
    name: str | None
    definition: ToolDefinition | None

    @cached_property
    def radius_mm(self) -> float:
        """Distance from the tool's origin to its outermost marker."""
        markers_mm = self.definition.markers_mm if self.definition else ()
        return max((math.hypot(*marker) for marker in markers_mm), default=0.0)


def load_tools(
    link: CommandLink, tools: Iterable[tuple[ToolOption, ToolDefinition]], note: Callable[[str], None]
) -> tuple[LoadedTool, ...]:
    """Free all port handles, then load, initialise and enable each tool; `note` receives warnings.

    Without tools the dummy passive tool is loaded, because a unit detects strays only while a passive handle
    is enabled. If the reply to PHRQ is lost, loading starts over once: repeating PHRQ would leak a handle.
    Raises NDI-03x for a tool that the unit refuses, NDI-013 when it has another one.
    """
    wanted = tuple(tools)
    try:
        return _load_all(link, wanted, note)
    except (BadReplyCrc, MalformedReply, NoReply):
        return _load_all(link, wanted, note)


def _load_all(
    link: CommandLink, tools: tuple[tuple[ToolOption, ToolDefinition], ...], note: Callable[[str], None]
) -> tuple[LoadedTool, ...]:
    for handle in list_handles(link, HandleQuery.ALL):  # ours or an earlier client's
        free_handle(link, handle)
    loaded = []
    for option, definition in tools:
        handle = request_handle(link, ndi.PHRQ_ANY_PASSIVE)
        _write_definition(link, handle, encode_definition(definition))
        _initialise(link, handle, option.name, note)
        if (difference := check_handle(link, handle, option.name, definition)) is not None:
            note(difference)
        link.ask("PENA", f"{handle:02X}{option.priority}")
        loaded.append(LoadedTool(handle, option.name, definition))
    if not loaded:
        handle = request_handle(link, ndi.PHRQ_DUMMY_PASSIVE)
        _initialise(link, handle, "dummy tool", note)
        link.ask("PENA", f"{handle:02X}{TrackingPriority.DYNAMIC}")
        loaded.append(LoadedTool(handle, None, None))
    enabled = list_handles(link, HandleQuery.ENABLED)
    if missing := [tool for tool in loaded if tool.handle not in enabled]:
        raise MalformedReply(
            "a tool that was enabled is not listed as enabled",
            expected=", ".join(f"{tool.handle:02X}" for tool in missing),
        )
    return tuple(loaded)


def _write_definition(link: CommandLink, handle: int, block: bytes) -> None:
    for address in range(0, len(block), ndi.PVWR_BLOCK_BYTES):
        chunk = block[address : address + ndi.PVWR_BLOCK_BYTES].ljust(ndi.PVWR_BLOCK_BYTES, b"\0")
        link.ask("PVWR", f"{handle:02X}{address:04X}{chunk.hex().upper()}")


def _initialise(link: CommandLink, handle: int, name: str, note: Callable[[str], None]) -> None:
    reply = link.ask("PINIT", f"{handle:02X}")
    if (warning := warning_meaning(reply)) is not None:
        note(f"{name}: {warning}")
    elif reply != ndi.REPLY_OKAY:
        raise MalformedReply("unknown reply to PINIT", wire=reply.encode())


def check_handle(link: CommandLink, handle: int, name: str, definition: ToolDefinition) -> str | None:
    """Return a notice if the unit reports another serial or part number; raises NDI-013 if both differ.

    Either byte order of the serial number is accepted, since firmware differs. A unit
    without PHINF is trusted.
    """
    try:
        text = link.ask("PHINF", f"{handle:02X}{TOOL_AND_PART_NUMBER}")
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
        raise FOREIGN_TOOL(
            f"handle {handle:02X} holds another tool than {name}", expected=expected, got=reported
        )
    return f"{name}: the unit reports {reported}, the definition has {expected}"


def request_handle(link: CommandLink, argument: str) -> int:
    """Request a port handle with PHRQ, without retries because a lost reply would leak a handle."""
    text = link.ask("PHRQ", argument, retry=False)
    try:
        handle = int(text, 16)
    except ValueError as error:
        raise MalformedReply("PHRQ returned no handle", wire=text.encode()) from error
    if not handle:
        raise MalformedReply("PHRQ returned handle 00", wire=text.encode())
    return handle


def free_handle(link: CommandLink, handle: int) -> None:
    """Free a port handle; a handle that is already free is not an error."""
    with suppress(HandleRefused):
        link.ask("PHF", f"{handle:02X}")


def list_handles(link: CommandLink, query: HandleQuery) -> dict[int, PortStatus]:
    """List the port handles for a PHSR query, with their status."""
    text = link.ask("PHSR", f"{query.value:02X}", reply_bytes=PHSR_BYTES)
    width = ndi.HANDLE_DIGITS + PHSR_STATUS_DIGITS
    try:
        count = int(text[:2], 16)
        records = [text[2 + k * width : 2 + (k + 1) * width] for k in range(count)]
        handles = {
            int(r[: ndi.HANDLE_DIGITS], 16): PortStatus(int(r[ndi.HANDLE_DIGITS :], 16)) for r in records
        }
    except ValueError as error:
        raise MalformedReply("unknown form of PHSR", wire=text.encode()) from error
    if len(text.rstrip()) != 2 + count * width or len(handles) != count:
        raise MalformedReply(f"PHSR announces {count} handles but sends another number", wire=text.encode())
    return handles
