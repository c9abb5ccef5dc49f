"""Port handles for the host to request, load, initialise and enable; wired tools and sockets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

from ronna_hw.bounded_input import read_bounded
from ronna_hw.wire.polaris import HANDLE_DIGITS, PVWR_SPACE_BYTES, HandleQuery, PortStatus, TrackingPriority
from ronna_hw.wire.polaris_rom import ROM_BYTES
from sim.polaris.errors import BAD_WIRED_TOOL
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, hexadecimal
from sim.polaris.unit.tool_definition import ToolDefinition

DEVICE_IDENTIFIER_BYTES = 8
LARGEST_FILE_BYTES = 65_536  # more than any memory holds

FIRST_HANDLE = 0x01
ALL_FACES = 0xFF


_STATUSES = {  # a table, because joining flags is slow and every reply needs this
    (occupied, initialised, enabled): PortStatus(
        PortStatus.OCCUPIED * occupied | PortStatus.INITIALISED * initialised | PortStatus.ENABLED * enabled
    )
    for occupied, initialised, enabled in product((False, True), repeat=3)
}


@dataclass
class Port:
    """A port handle."""

    handle: int
    dummy: bool = False  # without markers: only makes the illuminators fire
    memory: bytearray = field(default_factory=lambda: bytearray(PVWR_SPACE_BYTES))
    written: bool = False
    definition: ToolDefinition | None = None
    initialised: bool = False
    enabled: bool = False
    place: int | None = None  # in the scene, in order of loading
    wired_port: int = 0  # socket of a wired tool, 0 for a wireless one
    active_wireless: bool = False
    tool: WiredTool | None = None  # plugged into the socket
    unoccupied: bool = False  # the tool was unplugged
    faces: int = ALL_FACES  # faces that may be tracked (PFSEL)
    priority: str = TrackingPriority.DYNAMIC
    current_test: int = 0  # one bit per marker that passed TCTST
    firing: int = 0  # markers firing in diagnostic mode (IRED)

    @property
    def occupied(self) -> bool:
        """Whether the handle has a tool; passive tools cannot be unplugged."""
        return not self.unoccupied and (self.wired_port == 0 or self.dummy or self.tool is not None)

    @property
    def reflects(self) -> bool:
        """Whether the tool is lit by the unit's illuminators."""
        return self.wired_port == 0 and not self.active_wireless

    @property
    def status(self) -> PortStatus:
        """Port status for PHSR, PHINF, TX and BX."""
        return _STATUSES[self.occupied, self.initialised, self.enabled]


class PortTable:
    """Table of all port handles, which allocates the lowest free number."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._ports: dict[int, Port] = {}

    def __iter__(self) -> Iterator[Port]:
        return iter([self._ports[handle] for handle in sorted(self._ports)])

    def request(
        self,
        *,
        dummy: bool = False,
        active_wireless: bool = False,
        wired_port: int = 0,
        tool: WiredTool | None = None,
    ) -> Port:
        """Allocate a handle; raises CommandRefusal if none is left."""
        for handle in range(FIRST_HANDLE, FIRST_HANDLE + self._size):
            if handle not in self._ports:
                port = Port(
                    handle, dummy=dummy, active_wireless=active_wireless, wired_port=wired_port, tool=tool
                )
                self._ports[handle] = port
                return port
        raise CommandRefusal(NdiErrorCode.NO_HANDLES_LEFT)

    def request_wired(self, number: int, tool: WiredTool | None, *, dummy: bool = False) -> Port:
        """Allocate a handle for a socket; raises CommandRefusal if it already has one or none is left."""
        if self.find_by_socket(number) is not None:
            raise CommandRefusal(NdiErrorCode.PORT_HAS_HANDLE)
        port = self.request(dummy=dummy, wired_port=number, tool=None if dummy else tool)
        if port.tool is not None and port.tool.memory is not None:
            port.memory[:] = port.tool.memory
            port.written = True
        return port

    def find_by_socket(self, number: int) -> Port | None:
        """Return a socket's port, or None if it has no port or its tool has been unplugged."""
        return next((p for p in self if p.wired_port == number and not p.unoccupied), None)

    def unplug(self, number: int) -> None:
        """Mark a socket's tool as unplugged, keeping its handle until freed."""
        port = self.find_by_socket(number)
        if port is not None:
            port.unoccupied = True
            port.tool = None

    def port(self, handle: int) -> Port:
        """Return the port for a handle; raises CommandRefusal if the handle is not allocated."""
        try:
            return self._ports[handle]
        except KeyError:
            raise CommandRefusal(NdiErrorCode.HANDLE_NOT_ALLOCATED) from None

    def require_port(self, argument: str) -> Port:
        """Return the port addressed by a command's argument; raises CommandRefusal for an invalid handle."""
        return self.port(hexadecimal(argument[:HANDLE_DIGITS], NdiErrorCode.BAD_HANDLE))

    def require_occupied(self, argument: str) -> Port:
        """Return the addressed port; raises CommandRefusal if it has no tool plugged in."""
        port = self.require_port(argument)
        if port.unoccupied:
            raise CommandRefusal(NdiErrorCode.HANDLE_UNOCCUPIED)
        if not port.occupied:
            raise CommandRefusal(NdiErrorCode.NO_TOOL)
        return port

    def require_initialised(self, argument: str) -> Port:
        """Return the addressed port; raises CommandRefusal unless it is occupied and initialised."""
        port = self.require_occupied(argument)
        if not port.initialised:
            raise CommandRefusal(NdiErrorCode.HANDLE_NOT_INITIALISED)
        return port

    def require_wired(self, argument: str) -> Port:
        """Return the addressed port; raises CommandRefusal unless it is occupied by a wired tool."""
        port = self.require_occupied(argument)
        if not port.wired_port:
            raise CommandRefusal(NdiErrorCode.NOT_FOR_THIS_DEVICE)
        return port

    def free(self, handle: int) -> None:
        """Free a handle."""
        del self._ports[self.port(handle).handle]

    def free_all(self) -> None:
        """Free all handles."""
        self._ports.clear()

    def enabled(self) -> tuple[Port, ...]:
        """Return the enabled ports in handle order."""
        return tuple(port for port in self if port.enabled)

    def free_place(self) -> int:
        """Return the lowest place in the scene not taken by a loaded tool."""
        occupied_places = {port.place for port in self._ports.values()}
        return next(place for place in range(self._size + 1) if place not in occupied_places)

    def list_matching(self, query: HandleQuery) -> tuple[Port, ...]:
        """Return the ports matching a PHSR option."""
        if query is HandleQuery.ALL:
            return tuple(self)
        if query is HandleQuery.TO_BE_FREED:
            return tuple(port for port in self if port.unoccupied)
        occupied = tuple(port for port in self if not port.unoccupied)
        if query is HandleQuery.OCCUPIED:
            return tuple(port for port in occupied if not port.initialised)
        if query is HandleQuery.INITIALISED:
            return tuple(port for port in occupied if port.initialised and not port.enabled)
        return tuple(port for port in occupied if port.enabled)


@dataclass
class WiredTool:
    """A cabled tool, which needs TTCFG or PVWR if it has no `memory`."""

    memory: bytearray | None
    user_memory: bytearray
    identifier: str = "0" * 2 * DEVICE_IDENTIFIER_BYTES  # of its memory device

    @classmethod
    def from_definition(cls, content: bytes, number: int, user_memory_bytes: int) -> WiredTool:
        """Create a tool with `content` as its memory; raises PSU-002 if the length is wrong."""
        if len(content) < ROM_BYTES or len(content) > PVWR_SPACE_BYTES:
            raise BAD_WIRED_TOOL(
                f"the definition of wired tool {number} has {len(content)} bytes",
                expected=f"{ROM_BYTES} to {PVWR_SPACE_BYTES} bytes",
            )
        memory = bytearray(content.ljust(PVWR_SPACE_BYTES, b"\0"))
        return cls(memory, bytearray(user_memory_bytes), f"{number:0{2 * DEVICE_IDENTIFIER_BYTES}X}")


@dataclass
class WiredPorts:
    """Tool interface sockets, numbered from 1, with a `count` of 0 if there is no interface."""

    count: int
    tools: dict[int, WiredTool] = field(default_factory=dict)  # all available ones, plugged in or not
    plugged: set[int] = field(default_factory=set)

    def add(self, tool: WiredTool) -> None:
        """Plug a tool into the next free socket; raises PSU-002 if there is none."""
        number = len(self.tools) + 1
        if number > self.count:
            raise BAD_WIRED_TOOL(f"no port left for wired tool {number}", limit=f"{self.count} ports")
        self.tools[number] = tool
        self.plugged.add(number)

    def tool(self, number: int) -> WiredTool | None:
        """Return the tool plugged into a socket, or None if it is empty."""
        return self.tools.get(number) if number in self.plugged else None


def plug_in(definitions: list[Path], ports: int, user_memory_bytes: int) -> WiredPorts:
    """Plug in one wired tool per definition file, or create no sockets if there are none; raises PSU-002."""
    sockets = WiredPorts(ports if definitions else 0)
    for number, path in enumerate(definitions, start=1):
        try:
            content = read_bounded(path, LARGEST_FILE_BYTES)
        except OSError as error:
            raise BAD_WIRED_TOOL(f"cannot read {path.name}: {error.strerror}") from error
        sockets.add(WiredTool.from_definition(content, number, user_memory_bytes))
    return sockets
