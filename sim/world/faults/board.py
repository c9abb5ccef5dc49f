"""The faults that currently affect a device."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from sim.world.faults.fault import Fault
from sim.world.faults.language import parse_faults
from sim.world.world import World


class FaultBoard:
    """The current scripted faults of one device. Cheap to query when there are none."""

    def __init__(self, world: World, device: str, cycle: Callable[[], int] | None = None) -> None:
        """`cycle` returns the device's current cycle, if it counts cycles."""
        self._world = world
        self._device = device
        self._cycle = cycle
        self._cycles_began_s: dict[int, float] = {}  # start of the cycles that faults begin with
        self._version = -1
        self._faults: tuple[Fault, ...] = ()
        self._happened: set[tuple[Fault, float]] = set()  # momentary ones already reported, with their onset

    @property
    def empty(self) -> bool:
        """Whether the script has no fault of this device; the cheapest query."""
        self._refresh()
        return not self._faults

    def active(self, kind: str) -> tuple[Fault, ...]:
        """All active lasting faults of this kind."""
        return tuple(fault for fault in self.acting() if fault.kind.name == kind)

    def acting(self) -> tuple[Fault, ...]:
        """All active lasting faults of any kind."""
        return tuple(fault for fault, _ in self.acting_since())

    def acting_since(self) -> tuple[tuple[Fault, float], ...]:
        """The same, each with the theatre time at which it began."""
        now_s = self._world.clock.now_s()
        return tuple(
            (fault, onset_s)
            for fault, onset_s in self._onsets(now_s)
            if onset_s <= now_s < onset_s + fault.duration_s
        )

    def happened(self, kind: str) -> tuple[Fault, ...]:
        """Momentary faults of this kind that have become due since the last call; each is reported once.

        One bound to a step happens once each time the step is entered.
        """
        now_s = self._world.clock.now_s()
        due = []
        for fault, onset_s in self._onsets(now_s):
            happening = (fault, onset_s)
            if fault.kind.name == kind and onset_s <= now_s and happening not in self._happened:
                self._happened.add(happening)
                due.append(fault)
        return tuple(due)

    def _onsets(self, now_s: float) -> Iterator[tuple[Fault, float]]:
        """Each fault with the theatre time at which it begins."""
        self._refresh()
        if not self._faults:
            return
        step, started_ns = self._world.step()

        def cycle_began_s(cycle: int) -> float:
            if self._cycle is None or self._cycle() < cycle:
                return math.inf
            return self._cycles_began_s.setdefault(cycle, now_s)

        for fault in self._faults:
            yield fault, fault.onset_s(step, started_ns / 1e9, cycle_began_s)

    def _refresh(self) -> None:
        if self._world.fault_version() != self._version:
            version, text = self._world.fault_script()
            faults = parse_faults(text) if text.strip() else ()
            self._faults = tuple(fault for fault in faults if fault.kind.device == self._device)
            self._happened = {one for one in self._happened if one[0] in self._faults}
            self._version = version
