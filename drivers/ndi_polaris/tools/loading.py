"""Loads the tools of the theatre file into the unit: handle, definition and verification of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from drivers.ndi_polaris.errors import BadReplyCrc, MalformedReply, NoReply
from drivers.ndi_polaris.line.codec import warning_meaning
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.options import ToolOption
from drivers.ndi_polaris.rom.definition import ToolDefinition, encode_definition
from drivers.ndi_polaris.tools.check import check_handle
from drivers.ndi_polaris.tools.port_handles import free_handles, list_handles, request_handle
from ronna_hw.wire.polaris import (
    PHRQ_ANY_PASSIVE,
    PHRQ_DUMMY_PASSIVE,
    PVWR_BLOCK_BYTES,
    REPLY_OKAY,
    HandleQuery,
    TrackingPriority,
)


@dataclass(frozen=True)
class LoadedTool:
    """A tool and its port handle; the dummy tool has neither name nor definition."""

    handle: int
    name: str | None
    definition: ToolDefinition | None

    @cached_property
    def radius_mm(self) -> float:
        """Distance of the outermost marker from the tool's origin."""
        markers_mm = self.definition.markers_mm if self.definition else ()
        return max((math.hypot(*marker) for marker in markers_mm), default=0.0)


def load_tools(
    link: CommandLink,
    tools: Iterable[tuple[ToolOption, ToolDefinition]],
    deadline_s: float,
    note: Callable[[str], None],
) -> tuple[LoadedTool, ...]:
    """Free all handles, then load, initialise and enable each tool; `note` receives warnings.

    Without tools the dummy passive tool is loaded, because a unit detects strays only while a passive handle
    is enabled. If the reply to PHRQ is lost, loading starts over once: repeating PHRQ would leak a handle.
    Raises NDI-03x for a tool that the unit refuses, NDI-013 when it has another one.
    """
    wanted = tuple(tools)
    try:
        return _load(link, wanted, deadline_s, note)
    except (BadReplyCrc, MalformedReply, NoReply):
        return _load(link, wanted, deadline_s, note)


def _load(
    link: CommandLink,
    tools: tuple[tuple[ToolOption, ToolDefinition], ...],
    deadline_s: float,
    note: Callable[[str], None],
) -> tuple[LoadedTool, ...]:
    free_handles(link, deadline_s)
    loaded = []
    for option, definition in tools:
        handle = request_handle(link, PHRQ_ANY_PASSIVE, deadline_s)
        _write_definition(link, handle, encode_definition(definition), deadline_s)
        _initialise(link, handle, option.name, deadline_s, note)
        if (difference := check_handle(link, handle, option.name, definition, deadline_s)) is not None:
            note(difference)
        link.ask("PENA", f"{handle:02X}{option.priority}", deadline_s=deadline_s)
        loaded.append(LoadedTool(handle, option.name, definition))
    if not loaded:
        handle = request_handle(link, PHRQ_DUMMY_PASSIVE, deadline_s)
        _initialise(link, handle, "dummy tool", deadline_s, note)
        link.ask("PENA", f"{handle:02X}{TrackingPriority.DYNAMIC}", deadline_s=deadline_s)
        loaded.append(LoadedTool(handle, None, None))
    enabled = list_handles(link, HandleQuery.ENABLED, deadline_s)
    if missing := [tool for tool in loaded if tool.handle not in enabled]:
        raise MalformedReply(
            "a tool that was enabled is not listed as enabled",
            expected=", ".join(f"{tool.handle:02X}" for tool in missing),
        )
    return tuple(loaded)


def _write_definition(link: CommandLink, handle: int, block: bytes, deadline_s: float) -> None:
    for address in range(0, len(block), PVWR_BLOCK_BYTES):
        chunk = block[address : address + PVWR_BLOCK_BYTES].ljust(PVWR_BLOCK_BYTES, b"\0")
        link.ask("PVWR", f"{handle:02X}{address:04X}{chunk.hex().upper()}", deadline_s=deadline_s)


def _initialise(
    link: CommandLink, handle: int, name: str, deadline_s: float, note: Callable[[str], None]
) -> None:
    reply = link.ask("PINIT", f"{handle:02X}", deadline_s=deadline_s)
    if (warning := warning_meaning(reply)) is not None:
        note(f"{name}: {warning}")
    elif reply != REPLY_OKAY:
        raise MalformedReply("unknown reply to PINIT", wire=reply.encode())
