"""Fault script of a running theatre: active faults of a device, and script edits."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator

from sim.errors import BadFaultScript
from sim.world.faults.fault import Fault
from sim.world.faults.language import NOW, SINCE, STEP, has_beginning, parse_faults, parse_request
from sim.world.faults.room import DEVICE as ROOM
from sim.world.world import World

_SINCE_STEP = re.compile(rf"^\s*{SINCE}\s+step\s*==\s*{STEP}[^:]*:")


class FaultBoard:
    """Active faults of a device, cheap to query if there are none."""

    def __init__(self, world: World, device: str, cycle: Callable[[], int] | None = None) -> None:
        """Use `cycle` to read the current cycle of a device that counts cycles."""
        self._world = world
        self._device = device
        self._cycle = cycle
        self._cycles_began_s: dict[int, float] = {}  # theatre time at which a cycle was first seen
        self._version = -1
        self._faults: tuple[Fault, ...] = ()
        # Momentary faults already reported, with their onset.
        self._reported: set[tuple[Fault, float]] = set()

    @property
    def empty(self) -> bool:
        """Whether the script has no faults of this device; the cheapest query."""
        self._refresh()
        return not self._faults

    def active(self, kind: str) -> tuple[Fault, ...]:
        """Return the active lasting faults of a kind."""
        return tuple(fault for fault in self.acting() if fault.kind.name == kind)

    def acting(self) -> tuple[Fault, ...]:
        """Return the active lasting faults of all kinds."""
        return tuple(fault for fault, _ in self.acting_since())

    def acting_since(self) -> tuple[tuple[Fault, float], ...]:
        """Return the active lasting faults with the theatre time of each onset."""
        if self.empty:
            return ()
        now_s = self._world.clock.now_s()
        return tuple(
            (fault, onset_s)
            for fault, onset_s in self._list_onsets(now_s)
            if onset_s <= now_s < onset_s + fault.duration_s
        )

    def happened(self, kind: str) -> tuple[Fault, ...]:
        """Return each momentary fault of this kind that has become due since the last call.

        A fault bound to a step happens once each time the step is entered.
        """
        if self.empty:
            return ()
        now_s = self._world.clock.now_s()
        due = []
        for fault, onset_s in self._list_onsets(now_s):
            occurrence = (fault, onset_s)
            if fault.kind.name == kind and onset_s <= now_s and occurrence not in self._reported:
                self._reported.add(occurrence)
                due.append(fault)
        return tuple(due)

    def _list_onsets(self, now_s: float) -> Iterator[tuple[Fault, float]]:
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
            own_device = (fault for fault in faults if fault.kind.device == self._device)
            # What happens in the room is the same for the simulators of all arms.
            self._faults = tuple(
                fault for fault in own_device if self._device == ROOM or fault.role is self._world.role
            )
            self._reported = {one for one in self._reported if one[0] in self._faults}
            self._version = version


def format_beginning(now_s: float) -> str:
    """Format the start of a script line for a fault beginning at a theatre time, to the nanosecond.

    Coarser rounding could place it ahead of a clock that stands still until someone advances it.
    """
    return f"at {now_s:.9f} s"


def begin_now(line: str, now_s: float) -> str:
    """Replace `now`, or a missing start time, with the present theatre time."""
    if not has_beginning(line):
        return f"{format_beginning(now_s)}: {line}"
    trigger, colon, rest = line.partition(":")
    return f"{format_beginning(now_s)}{colon}{rest}" if trigger.strip() == NOW else line


def begin_with_step(text: str, step: str, now_s: float) -> str:
    """Start the faults scripted `since` a step at the present theatre time plus their delay."""
    lines = text.split("\n")
    for fault in parse_faults(text):
        if fault.lasts and fault.begins_in(step):
            begins = f"{format_beginning(now_s + fault.after_s)}:"
            lines[fault.line - 1] = _SINCE_STEP.sub(begins, lines[fault.line - 1])
    return "\n".join(lines)


def without_fault(text: str, line: str) -> str:
    """Remove a fault from the script regardless of when it begins; raises SIM-003 if it is not there."""
    phrase = parse_request(line).phrase
    faults = parse_faults(text)
    ended = {fault.line for fault in faults if fault.phrase == phrase}
    if not ended:
        others = sorted({repr(fault.phrase) for fault in faults})
        raise BadFaultScript(
            f"there is no fault {phrase!r} to clear",
            expected=", ".join(others) or "one that was injected",
            action="`ronna-sim fault --clear` clears all.",
        )
    return "\n".join(one for number, one in enumerate(text.split("\n"), 1) if number not in ended)
