"""Wired tools and the sockets they are plugged into."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from ronna_hw.bounded_input import read_bounded
from ronna_hw.wire.polaris import PVWR_SPACE_BYTES
from ronna_hw.wire.polaris_rom import ROM_BYTES
from sim.polaris.errors import BadWiredTool

DEVICE_IDENTIFIER_BYTES = 8
LARGEST_FILE_BYTES = 65_536  # beyond any memory: rejected by its length


@dataclass
class WiredTool:
    """A tool on a cable; without `memory` it needs TTCFG or PVWR."""

    memory: bytearray | None
    user_memory: bytearray
    identifier: str = "0" * 2 * DEVICE_IDENTIFIER_BYTES  # of its memory device

    @classmethod
    def from_definition(cls, content: bytes, number: int, user_memory_bytes: int) -> WiredTool:
        """A tool with `content` in its memory; raises PSU-002 when the length is wrong."""
        if len(content) < ROM_BYTES or len(content) > PVWR_SPACE_BYTES:
            raise BadWiredTool(
                f"the definition of wired tool {number} has {len(content)} bytes",
                expected=f"{ROM_BYTES} to {PVWR_SPACE_BYTES} bytes",
            )
        memory = bytearray(content.ljust(PVWR_SPACE_BYTES, b"\0"))
        return cls(memory, bytearray(user_memory_bytes), f"{number:0{2 * DEVICE_IDENTIFIER_BYTES}X}")


@dataclass
class WiredPorts:
    """The sockets of the tool interface, numbered from 1; `count` is 0 without an interface."""

    count: int
    tools: dict[int, WiredTool] = field(default_factory=dict)  # all available ones, plugged in or not
    plugged: set[int] = field(default_factory=set)

    def add(self, tool: WiredTool) -> None:
        """Plug a tool into the next free socket; raises PSU-002 when there is none."""
        number = len(self.tools) + 1
        if number > self.count:
            raise BadWiredTool(f"no port left for wired tool {number}", limit=f"{self.count} ports")
        self.tools[number] = tool
        self.plugged.add(number)

    def tool(self, number: int) -> WiredTool | None:
        """The tool plugged into a socket, if any."""
        return self.tools.get(number) if number in self.plugged else None


def plugged_in(definitions: list[Path], ports: int, user_memory_bytes: int) -> WiredPorts:
    """Sockets with one wired tool per definition file; no sockets without any. Raises PSU-002."""
    sockets = WiredPorts(ports if definitions else 0)
    for number, path in enumerate(definitions, start=1):
        try:
            content = read_bounded(path, LARGEST_FILE_BYTES)
        except OSError as error:
            raise BadWiredTool(f"cannot read {path.name}: {error.strerror}") from error
        sockets.add(WiredTool.from_definition(content, number, user_memory_bytes))
    return sockets
