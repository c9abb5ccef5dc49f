"""One line of a fault script."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim.theatre.faults.kinds import Arguments, FaultKind


@dataclass(frozen=True)
class Fault:
    """One fault of a script: either `at_s` or `step` says when it begins."""

    kind: FaultKind
    arguments: Arguments
    duration_s: float  # theatre time; 0 for a momentary fault, infinite when no end is given
    at_s: float | None = None
    step: str | None = None
    line: int = 1  # of the script

    @property
    def argument(self) -> str:
        """The first argument; an empty text for a fault without one."""
        return self.arguments[0] if self.arguments else ""

    def onset_s(self, step: str, step_started_s: float) -> float:
        """Theatre time at which it begins; infinite while its step does not run."""
        if self.at_s is not None:
            return self.at_s
        if self.step in (step, step.partition(":")[0]):
            return step_started_s
        return math.inf

    def active(self, now_s: float, step: str, step_started_s: float) -> bool:
        """True while a lasting fault acts."""
        begin = self.onset_s(step, step_started_s)
        return begin <= now_s < begin + self.duration_s
