"""Port handles: what a client has requested, loaded, initialised and enabled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ronna_hw.wire.polaris import PVWR_SPACE_BYTES, HandleQuery, PortStatus
from sim.polaris.definition import ToolDefinition
from sim.polaris.refusal import ErrorCode, Refusal

FIRST_HANDLE = 0x01


@dataclass
class Port:
    """One handle of a passive tool. `place` numbers the places of a scene in order of loading."""

    handle: int
    dummy: bool = False  # it has no markers; it only makes the illuminators fire
    memory: bytearray = field(default_factory=lambda: bytearray(PVWR_SPACE_BYTES))
    written: bool = False
    definition: ToolDefinition | None = None
    initialised: bool = False
    enabled: bool = False
    place: int | None = None

    @property
    def status(self) -> PortStatus:
        """Status of the handle as PHSR, PHINF, TX and BX tell it."""
        status = PortStatus.OCCUPIED
        if self.initialised:
            status |= PortStatus.INITIALISED
        if self.enabled:
            status |= PortStatus.ENABLED
        return status


class PortTable:
    """All handles of the unit; a new one gets the lowest free number."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._ports: dict[int, Port] = {}

    def __iter__(self) -> Iterator[Port]:
        return iter([self._ports[handle] for handle in sorted(self._ports)])

    def request(self, *, dummy: bool) -> Port:
        """A new handle; raises Refusal when none is left."""
        for handle in range(FIRST_HANDLE, FIRST_HANDLE + self._size):
            if handle not in self._ports:
                port = Port(handle, dummy=dummy)
                self._ports[handle] = port
                return port
        raise Refusal(ErrorCode.NO_HANDLES_LEFT)

    def port(self, handle: int) -> Port:
        """The port of a handle; raises Refusal when it was never allocated."""
        try:
            return self._ports[handle]
        except KeyError:
            raise Refusal(ErrorCode.HANDLE_NOT_ALLOCATED) from None

    def free(self, handle: int) -> None:
        """Give a handle back."""
        del self._ports[self.port(handle).handle]

    def free_all(self) -> None:
        """Forget every handle."""
        self._ports.clear()

    def enabled(self) -> tuple[Port, ...]:
        """The enabled ports, in order of their handles."""
        return tuple(port for port in self if port.enabled)

    def free_place(self) -> int:
        """The lowest place of the scene that no loaded tool has."""
        taken = {port.place for port in self._ports.values()}
        return next(place for place in range(self._size + 1) if place not in taken)

    def matching(self, query: HandleQuery) -> tuple[Port, ...]:
        """The ports that a PHSR option asks for."""
        if query is HandleQuery.OCCUPIED:
            return tuple(port for port in self if not port.initialised)
        if query is HandleQuery.INITIALISED:
            return tuple(port for port in self if port.initialised and not port.enabled)
        if query is HandleQuery.ENABLED:
            return self.enabled()
        # Nobody unplugs a passive tool, so none waits to be freed.
        return () if query is HandleQuery.TO_BE_FREED else tuple(self)
