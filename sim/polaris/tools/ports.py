"""Port handles: requested, loaded, initialised and enabled by the host."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ronna_hw.wire.polaris import PVWR_SPACE_BYTES, HandleQuery, PortStatus, TrackingPriority
from sim.polaris.tools.definition import ToolDefinition
from sim.polaris.tools.wired_tools import WiredTool
from sim.polaris.unit.refusal import ErrorCode, Refusal

FIRST_HANDLE = 0x01
ALL_FACES = 0xFF


@dataclass
class Port:
    """One handle. `place` is the tool's place in the scene, in order of loading."""

    handle: int
    dummy: bool = False  # has no markers; only makes the illuminators fire
    memory: bytearray = field(default_factory=lambda: bytearray(PVWR_SPACE_BYTES))
    written: bool = False
    definition: ToolDefinition | None = None
    initialised: bool = False
    enabled: bool = False
    place: int | None = None
    wired_port: int = 0  # socket of a wired tool, 0 for a wireless one
    active_wireless: bool = False
    tool: WiredTool | None = None  # on the cable
    unoccupied: bool = False  # its tool was unplugged
    faces: int = ALL_FACES  # faces that may be tracked (PFSEL)
    priority: str = TrackingPriority.DYNAMIC
    current_test: int = 0  # one bit per marker that passed TCTST
    firing: int = 0  # markers firing in diagnostic mode (IRED)

    @property
    def occupied(self) -> bool:
        """Whether the handle has a tool; a passive one cannot be unplugged."""
        return not self.unoccupied and (self.wired_port == 0 or self.dummy or self.tool is not None)

    @property
    def reflects(self) -> bool:
        """Whether its tool is lit by the unit's own illuminators."""
        return self.wired_port == 0 and not self.active_wireless

    @property
    def status(self) -> PortStatus:
        """Port status as in PHSR, PHINF, TX and BX."""
        status = PortStatus.OCCUPIED if self.occupied else PortStatus(0)
        if self.initialised:
            status |= PortStatus.INITIALISED
        if self.enabled:
            status |= PortStatus.ENABLED
        return status


class PortTable:
    """All handles; a new one gets the lowest free number."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._ports: dict[int, Port] = {}

    def __iter__(self) -> Iterator[Port]:
        return iter([self._ports[handle] for handle in sorted(self._ports)])

    def request(self, *, dummy: bool = False, active_wireless: bool = False) -> Port:
        """A new handle for a wireless tool; raises Refusal when none is left."""
        return self._new(dummy=dummy, active_wireless=active_wireless)

    def request_wired(self, number: int, tool: WiredTool | None, *, dummy: bool = False) -> Port:
        """A new handle for a socket; raises Refusal if it already has one, or none is left."""
        if self.of_socket(number) is not None:
            raise Refusal(ErrorCode.PORT_HAS_HANDLE)
        port = self._new(dummy=dummy, wired_port=number, tool=None if dummy else tool)
        if port.tool is not None and port.tool.memory is not None:
            port.memory[:] = port.tool.memory
            port.written = True
        return port

    def of_socket(self, number: int) -> Port | None:
        """The handle of a socket; one whose tool was unplugged no longer counts."""
        return next((p for p in self if p.wired_port == number and not p.unoccupied), None)

    def unplug(self, number: int) -> None:
        """Mark the tool of a socket as unplugged; its handle stays until freed."""
        port = self.of_socket(number)
        if port is not None:
            port.unoccupied = True
            port.tool = None

    def port(self, handle: int) -> Port:
        """The port of a handle; raises Refusal when it was never allocated."""
        try:
            return self._ports[handle]
        except KeyError:
            raise Refusal(ErrorCode.HANDLE_NOT_ALLOCATED) from None

    def free(self, handle: int) -> None:
        """Free a handle."""
        del self._ports[self.port(handle).handle]

    def free_all(self) -> None:
        """Free all handles."""
        self._ports.clear()

    def enabled(self) -> tuple[Port, ...]:
        """The enabled ports, in order of their handles."""
        return tuple(port for port in self if port.enabled)

    def free_place(self) -> int:
        """The lowest place in the scene not used by a loaded tool."""
        taken = {port.place for port in self._ports.values()}
        return next(place for place in range(self._size + 1) if place not in taken)

    def matching(self, query: HandleQuery) -> tuple[Port, ...]:
        """The ports that a PHSR option lists."""
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

    def _new(
        self,
        *,
        dummy: bool,
        active_wireless: bool = False,
        wired_port: int = 0,
        tool: WiredTool | None = None,
    ) -> Port:
        for handle in range(FIRST_HANDLE, FIRST_HANDLE + self._size):
            if handle not in self._ports:
                port = Port(
                    handle, dummy=dummy, active_wireless=active_wireless, wired_port=wired_port, tool=tool
                )
                self._ports[handle] = port
                return port
        raise Refusal(ErrorCode.NO_HANDLES_LEFT)
