"""The person at the table and the hands in the room, or the scripts that stand in for them.

A confirmation shows the value that is confirmed, and is recorded with it. A time-out means no.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Question:
    """What is asked: `subject` names the decision, `value` is what is being confirmed."""

    subject: str
    value: str
    timeout_s: float = 300.0


class Operator(Protocol):
    """Who decides."""

    def confirm(self, question: Question) -> bool:
        """Answer a question; False also when no answer came in time."""
        ...


class Room(Protocol):
    """Who acts: whoever changes tools, and wants to know which step is running."""

    def announce(self, step: str) -> None:
        """Hear which step runs now, such as `at_target:T1`."""
        ...

    def change_tool(self, number: int, description: str) -> None:
        """Mount another tool; the step then has it confirmed and reads the controller's inputs."""
        ...
