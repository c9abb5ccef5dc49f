"""One line of a fault script."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from sim.world.faults.kinds import TERMINALS, Arguments, FaultKind


def _never(_cycle: int) -> float:
    return math.inf


@dataclass(frozen=True)
class Fault:
    """One fault of a script: one of `at_s`, `step` and `cycle` determines when it begins."""

    kind: FaultKind
    arguments: Arguments
    duration_s: float  # theatre time; 0 for a momentary fault, infinite without an end
    at_s: float | None = None
    step: str | None = None
    lasts: bool = False  # beyond that step
    after_s: float = 0.0  # that step's first beginning
    cycle: int | None = None  # of the robot's controller
    line: int = 1  # of the script

    @property
    def argument(self) -> str:
        """The first argument; an empty text for a fault without one."""
        return self.arguments[0] if self.arguments else ""

    @property
    def phrase(self) -> str:
        """As written in a script, without beginning and duration."""
        words = iter(self.arguments)
        return " ".join(
            next(words) if word in TERMINALS else word
            for word in (self.kind.device, *self.kind.phrase.split())
        )

    @property
    def effect(self) -> str:
        """Its effect and timing, as shown to the person who injected it."""
        begins = "from now on" if self.at_s is None else f"from theatre time {self.at_s:.3f} s on"
        if self.step is not None:
            later = f"{self.after_s:g} s after " if self.after_s else "when "
            begins = f"{later if self.lasts else 'whenever '}step {self.step} begins"
        if self.cycle is not None:
            begins = f"from cycle {self.cycle} on"
        lasts = "until cleared" if math.isinf(self.duration_s) else f"for {self.duration_s:g} s"
        if self.step is not None and not self.lasts:
            lasts = "until that step ends" if math.isinf(self.duration_s) else f"{lasts} of that step"
        return f"{self.phrase}, {begins}, {'once' if self.kind.momentary else lasts}. {self.kind.meaning}"

    def onset_s(
        self, step: str, step_started_s: float, cycle_began_s: Callable[[int], float] = _never
    ) -> float:
        """Theatre time at which it begins; infinite while its step is not running, or before its cycle."""
        if self.at_s is not None:
            return self.at_s
        if self.cycle is not None:
            return cycle_began_s(self.cycle)
        if self.begins_in(step) and not self.lasts:  # the control port sets a time for those
            return step_started_s
        return math.inf

    def begins_in(self, step: str) -> bool:
        """Whether it begins with that step."""
        return self.step in (step, step.partition(":")[0])
