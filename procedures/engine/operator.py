"""The person at the table, or the script that stands in for one.

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
    """What the engine needs of the operator."""

    def announce(self, step: str) -> None:
        """Hear which step runs now, such as `at_target:T1`."""
        ...

    def confirm(self, question: Question) -> bool:
        """Answer a question; False also when no answer came in time."""
        ...

    def change_tool(self, number: int, description: str) -> None:
        """Have another tool mounted; the step then has it confirmed and reads the controller's inputs."""
        ...
