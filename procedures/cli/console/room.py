"""The room's hands, whose readings the operator at the console types."""

from __future__ import annotations

from dataclasses import replace

from procedures.cli.console.pilot import Pilot
from procedures.operator.room import Room, Task


class ConsoleRoom:
    """Asks at the console while it operates the case; `otherwise` says at the terminal what is to be done."""

    def __init__(self, otherwise: Room, pilot: Pilot) -> None:
        self._otherwise = otherwise
        self._pilot = pilot

    def announce(self, step: str) -> None:
        """As whoever is there without it."""
        self._otherwise.announce(step)

    def change_tool(self, number: int, description: str) -> None:
        """As whoever is there without it; the step has it confirmed at the console."""
        self._otherwise.change_tool(number, description)

    def prepare_stand(self, holds: str) -> None:
        """As `change_tool`."""
        self._otherwise.prepare_stand(holds)

    def work(self, task: Task) -> tuple[float, ...]:
        """As `change_tool`; what is read off is typed at the console, nothing when nobody does."""
        if task.reads and self._pilot.in_charge:
            self._otherwise.work(replace(task, reads=()))
            if (readings := self._pilot.read(task)) is not None:
                return readings
        return self._otherwise.work(task)
