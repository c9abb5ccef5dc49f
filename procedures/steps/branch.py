"""A branch of a case: what happens, what notices it, what is done about it, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from procedures.operator.question import Question, Topic
from ronna_hw.errors import RonnaError


class Ending(StrEnum):
    """How a branch ends."""

    HOLD = "hold"  # the step fails with an error: arm at rest, every result stands
    ASK = "ask"  # the operator decides; what is not agreed to is held
    ABORT = "abort"  # the case ends
    RECORDED = "recorded"  # no motion depends on it: it goes on, and the record says so


@dataclass(frozen=True)
class Branch:
    """One row. `errors` are what it holds with, or holds with when the answer is no."""

    event: str
    detected_by: str
    steps: tuple[str, ...]  # in which it can happen; none for any
    action: str
    ending: Ending
    errors: tuple[type[RonnaError], ...] = ()
    topic: Topic | None = None
    answers: tuple[str, ...] = ()

    def question(
        self,
        subject: str,
        value: str,
        trajectory: str | None = None,
        answers: tuple[str, ...] | None = None,
    ) -> Question:
        """What the operator is asked, with all answers by default. Raises ValueError when nothing is."""
        if self.topic is None:
            raise ValueError(f"no question is defined for: {self.event}")
        return Question(self.topic, subject, value, answers or self.answers, trajectory)
