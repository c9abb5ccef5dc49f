"""What happened in a run beside the plain course of its steps, and what the operator was asked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from procedures.engine.journal import Entry, JournalValue, Line, theatre_time_s

# Lines that the timeline, the questions or the list of records show.
PLAIN = (Entry.OPENED, Entry.INTENT, Entry.MOTION, Entry.MOVED, Entry.CONFIRMATION, Entry.WORK, Entry.CLOSED)
FRAME = ("sequence", "previous", "entry", "host_time", "theatre_time_s", "step")  # of every line


@dataclass(frozen=True)
class Happening:
    """One line: when, in which step, what kind, in which words."""

    theatre_time_s: float
    kind: str
    step: str
    text: str


@dataclass(frozen=True)
class AskedQuestion:
    """A question as it was shown, and its answer."""

    theatre_time_s: float
    topic: str
    subject: str
    value: str
    answer: str


def questions(journal: Sequence[Line]) -> tuple[AskedQuestion, ...]:
    """Every question with its answer, in order."""
    return tuple(
        AskedQuestion(
            theatre_time_s(line), *(str(line.get(key, "")) for key in ("topic", "subject", "value", "answer"))
        )
        for line in journal
        if line["entry"] == Entry.CONFIRMATION
    )


def happenings(journal: Sequence[Line]) -> tuple[Happening, ...]:
    """Refusals, rests, faults, superseded results, and every kind of line that is not of the plain course."""
    return tuple(_happenings(journal))


def _happenings(journal: Sequence[Line]) -> Iterator[Happening]:
    step = ""
    for line in journal:
        entry = str(line["entry"])
        if entry == Entry.INTENT:
            step = str(line.get("step", ""))
        if entry in PLAIN:
            continue
        where, time_s = str(line.get("step", step)), theatre_time_s(line)
        if entry == Entry.RESULT:
            if gone := line.get("supersedes"):
                yield Happening(
                    time_s, "superseded", where, f"{line.get('record')} supersedes {_words(gone)}"
                )
        elif entry == Entry.REFUSED:
            yield Happening(time_s, entry, where, _words(line.get("unmet")))
        elif entry == Entry.FAILED:
            yield Happening(time_s, "fault", where, str(line.get("what", line.get("code", ""))))
        elif entry == Entry.RESTED:
            yield Happening(time_s, str(line.get("state", entry)), where, str(line.get("reason", "")))
        elif entry == Entry.FINDING:
            yield Happening(time_s, entry, where, str(line.get("text", "")))
        elif entry == Entry.INTERRUPTED:
            yield Happening(time_s, entry, where, "the step was ended; the arm was stopped")
        else:  # also of kinds that this module does not know
            rest = {key: value for key, value in line.items() if key not in FRAME and value is not None}
            yield Happening(
                time_s, entry, where, ", ".join(f"{key} {_words(one)}" for key, one in rest.items())
            )


def _words(value: JournalValue) -> str:
    if isinstance(value, list | tuple):
        return "; ".join(map(str, value))
    return str(value)
