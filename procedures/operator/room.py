"""The room's hands, which act, or the script that stands in for them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Task:
    """What hands are to do, by its name in `ronna_hw.wire.room_tasks`, and what they read off after it.

    `numbers` are what they need for it; `reads` names each reading, such as `depth stop in mm`, and
    `plausible_mm` is its possible range: something else was mistyped.
    """

    name: str
    subject: str  # for a person
    trajectory: str | None = None
    numbers: tuple[float, ...] = ()
    reads: tuple[str, ...] = ()
    plausible_mm: tuple[float, float] | None = None


def misread(reading: float, plausible_mm: tuple[float, float] | None) -> str:
    """Why it was mistyped; empty if it may be right."""
    low, high = plausible_mm or (-math.inf, math.inf)
    if low <= reading <= high:
        return ""
    in_cm = "; did you type centimetres?" if low <= 10.0 * reading <= high else ""
    return f"{reading:g} is implausible: expected {low:g} to {high:g}{in_cm}"


class Room(Protocol):
    """Who acts: whoever changes tools and works on the patient, and wants to know which step is running."""

    def announce(self, step: str) -> None:
        """Hear which step runs now, such as `at_target:T1`."""
        ...

    def change_tool(self, number: int, description: str) -> None:
        """Mount another tool; the step then has it confirmed and reads the controller's inputs."""
        ...

    def prepare_stand(self, holds: str) -> None:
        """Put the ball or the divot on the calibration stand; the step then has it confirmed."""
        ...

    def work(self, task: Task) -> tuple[float, ...]:
        """Do it and read off what is asked for; nothing when nobody does. The step has it confirmed."""
        ...
