"""A question, and the operator who answers it, or the script that stands in for one.

A question shows the value that is being decided on and is recorded with it. Silence is the last answer, which
never continues. Only one of the listed words answers; anything else is asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from procedures.operator.evidence import Evidence
from procedures.operator.topic import DELIBERATE, Topic
from ronna_hw.text import without_unit

YES, NO = "yes", "no"
READ, NOBODY = "read", "nobody"  # to a question for readings


@dataclass(frozen=True)
class ReadBack:
    """What a person types after the answer that goes on: nobody who did not look knows it.

    `what` asks for it, such as `how many mm it moves`. `value` may be the patient's: no record has it.
    `wrong` follows what else was typed; `shown` is where the question has the value, if it does. The `unit`
    may be typed with it.
    """

    what: str
    value: str = field(repr=False)
    wrong: str = "is not the value to be read back"
    shown: str = ""
    unit: str = ""

    def fits(self, typed: str) -> bool:
        """Whether that was typed, whatever its capitals and the space around it."""
        return without_unit(typed, self.unit).casefold() == self.value.strip().casefold()


def _unrecorded() -> None:
    """Nobody keeps it."""


@dataclass(frozen=True)
class Signature:
    """Who answered at a console, and of what: the digest of what was shown."""

    by: str
    session: str
    shown: str


def _unsigned(_signature: Signature) -> None:
    """Nobody keeps it."""


def _unread(_readings: tuple[float, ...]) -> None:
    """Nobody wants them."""


@dataclass(frozen=True)
class Question:
    """What is asked. The first of `answers` goes on, the last is what silence means.

    `timeout_s` is host time; None waits until someone answers. The operator calls `misread` each time a wrong
    value was read back, and `signed` once before it returns an answer that a named person gave. `number`
    counts the questions of a run; `evidence` is shown with the value. Where `reads` says what is read off,
    the answer that goes on comes with that many numbers, each within `plausible_mm`, which `read` is called
    with.
    """

    topic: Topic
    subject: str
    value: str
    answers: tuple[str, ...] = (YES, NO)
    trajectory: str | None = None
    timeout_s: float | None = 300.0
    read_back: ReadBack | None = None
    misread: Callable[[], None] = field(default=_unrecorded, compare=False, repr=False)
    signed: Callable[[Signature], None] = field(default=_unsigned, compare=False, repr=False)
    number: int = 0
    evidence: tuple[Evidence, ...] = ()
    reads: tuple[str, ...] = ()
    plausible_mm: tuple[float, float] | None = None
    read: Callable[[tuple[float, ...]], None] = field(default=_unread, compare=False, repr=False)

    @property
    def name(self) -> str:
        """Its stable name, as answer files have it: the topic, and the trajectory if it belongs to one."""
        return f"{self.topic}:{self.trajectory}" if self.trajectory else str(self.topic)

    @property
    def deliberate(self) -> bool:
        """Whether the answer that goes on moves the arm, or lets it go by a result: no slip may give it."""
        return self.topic in DELIBERATE

    @property
    def silence(self) -> str:
        """What no answer in time means."""
        return self.answers[-1]


class Operator(Protocol):
    """Who decides."""

    def ask(self, question: Question) -> str:
        """One of the question's answers; the last one also when none came in time."""
        ...


def words(answers: Sequence[str]) -> str:
    """The answers as a person reads them: `yes or no`; those of several words are quoted."""
    *others, last = [f"'{answer}'" if " " in answer else answer for answer in answers]
    return f"{', '.join(others)} or {last}" if others else last
