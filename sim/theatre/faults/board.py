"""What a device asks before it acts: which faults concern me now?"""

from __future__ import annotations

from sim.theatre.faults.fault import Fault
from sim.theatre.faults.language import parse_faults
from sim.theatre.world import World


class FaultBoard:
    """The faults of one device, as the world's script has them now. Cheap to ask while there are none."""

    def __init__(self, world: World, device: str) -> None:
        self._world = world
        self._device = device
        self._version = -1
        self._faults: tuple[Fault, ...] = ()
        self._happened: set[tuple[int, float]] = set()  # line and onset of momentary faults already told

    @property
    def empty(self) -> bool:
        """True while the script has no fault of this device; the cheapest question of all."""
        self._refresh()
        return not self._faults

    def active(self, kind: str) -> tuple[Fault, ...]:
        """All lasting faults of that kind that act now."""
        self._refresh()
        if not self._faults:
            return ()
        step, started_ns = self._world.step()
        now_s = self._world.clock.now_s()
        return tuple(
            fault
            for fault in self._faults
            if fault.kind.name == kind and fault.active(now_s, step, started_ns / 1e9)
        )

    def acting(self) -> tuple[Fault, ...]:
        """All lasting faults of any kind that act now."""
        self._refresh()
        if not self._faults:
            return ()
        step, started_ns = self._world.step()
        now_s = self._world.clock.now_s()
        return tuple(fault for fault in self._faults if fault.active(now_s, step, started_ns / 1e9))

    def happened(self, kind: str) -> tuple[Fault, ...]:
        """Momentary faults of that kind whose moment has come since the last call; each is told once.

        One that is bound to a step happens once each time the step is entered.
        """
        self._refresh()
        if not self._faults:
            return ()
        step, started_ns = self._world.step()
        now_s = self._world.clock.now_s()
        told = []
        for fault in self._faults:
            onset_s = fault.onset_s(step, started_ns / 1e9)
            key = (fault.line, onset_s)
            if fault.kind.name == kind and onset_s <= now_s and key not in self._happened:
                self._happened.add(key)
                told.append(fault)
        return tuple(told)

    def _refresh(self) -> None:
        if self._world.fault_version() != self._version:
            version, text = self._world.fault_script()
            faults = parse_faults(text) if text.strip() else ()
            self._faults = tuple(fault for fault in faults if fault.kind.device == self._device)
            self._version = version
