"""Notable events of a run besides its normal steps, and the questions asked of the operator."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from procedures.calibration.errors import PlatformMoved
from procedures.guards.errors import BaseShifted, FrameSlipped, PatientMoved
from procedures.journal.journal import Entry, JournalValue, Line, theatre_time_s
from procedures.reporting.numbers import NOT_KNOWN
from procedures.workcell.arm_history import MotionKind
from ronna_hw.evidence.lost_journal_end import LOST
from ronna_hw.roles import MASTER
from ronna_hw.text import format_count

ADVICE = re.compile(r"\. (?=[A-Z])")  # follows the first sentence of an error
MOVES = (BaseShifted.code, PatientMoved.code, FrameSlipped.code, PlatformMoved.code)
_NOTICES: Mapping[str, tuple[str, Callable[[Line], str]]] = {
    Entry.FINDING: ("finding", lambda line: str(line.get("text", ""))),
    Entry.SEAT: (
        "seat",
        lambda line: (
            f"{line['by']} took the operator's seat" if line.get("by") else "The operator's seat became free"
        ),
    ),
}


@dataclass(frozen=True)
class RunEvent:
    """Event with wall-clock and theatre time, kind, step and text."""

    clock_time: str
    theatre_time_s: float
    kind: str
    step: str
    text: str


@dataclass(frozen=True)
class AskedQuestion:
    """Question as shown to the operator, with the answer."""

    clock_time: str
    theatre_time_s: float
    topic: str
    subject: str
    value: str
    answer: str


def questions(journal: Sequence[Line]) -> tuple[AskedQuestion, ...]:
    """Return every question with its answer, in order."""
    asked = []
    for line in (line for line in journal if line["entry"] == Entry.CONFIRMATION):
        texts = (_on_one_line(line.get(key, "")) for key in ("topic", "subject", "value", "answer"))
        asked.append(AskedQuestion(clock_time(line), theatre_time_s(line), *texts))
    return tuple(asked)


def _on_one_line(shown: object) -> str:
    return "; ".join(str(shown).splitlines())


def notable_events(journal: Sequence[Line]) -> tuple[RunEvent, ...]:
    """Return refusals, pauses, faults, acknowledgements, repetitions and voided results.

    Findings that every program opening a run makes about the previous one are reported once.
    """
    found = {_restart_text(line) for line in journal if line["entry"] == Entry.RESTARTED}
    first: dict[str, RunEvent] = {}
    for number, one in enumerate(_events_of_kinds(journal, _SENTENCES)):
        first.setdefault(one.text if one.text in found else str(number), one)
    return tuple(first.values())


def moves(journal: Sequence[Line]) -> tuple[RunEvent, ...]:
    """Return each move of cart, tracker, head or patient's frame that was found, with what it voided."""
    first: dict[str, RunEvent] = {}
    for line in journal:
        if line["entry"] in (Entry.VOIDED, Entry.FAILED) and line.get("code") in MOVES:
            _code, _, words = str(line.get("what", "")).partition(": ")
            what, gone = ADVICE.split(words)[0], line.get("supersedes")
            count = len(gone) if isinstance(gone, list) else 0
            voided = f"; {format_count(count, 'result')} no longer valid" if count else ""
            event = RunEvent(
                clock_time(line), theatre_time_s(line), "move", str(line.get("step", "")), what + voided
            )
            first.setdefault(what, event)
    return tuple(first.values())


def advisories(journal: Sequence[Line]) -> tuple[RunEvent, ...]:
    """Return findings and seat changes that did not stop the run, without duplicates."""
    first: dict[str, RunEvent] = {}
    for one in _events_of_kinds(journal, _NOTICES):
        first.setdefault(one.text, one)
    return tuple(first.values())


def begun_insertions(journal: Sequence[Line]) -> tuple[str, ...]:
    """List the trajectories at which an arm began to lead an instrument into the master's guide, in order."""
    begun = (
        str(line.get("trajectory"))
        for line in journal
        if (line["entry"], line.get("what")) == (Entry.MOTION, MotionKind.INSERT)
        and line.get("arm", MASTER) != MASTER
    )
    return tuple(dict.fromkeys(begun))


def last_held_name(journal: Sequence[Line]) -> str:
    """Name what an arm held last in its holder: a drill is never told as an instrument."""
    held = next((line for line in reversed(journal) if line["entry"] == Entry.HELD and line["held"]), None)
    return "drill" if held is not None and held.get("drill") else "instrument"


def clock_time(line: Line) -> str:
    """Return the wall-clock time of a line, or a dash if unknown."""
    try:
        return f"{datetime.fromisoformat(str(line.get('host_time'))).astimezone():%H:%M:%S}"
    except ValueError:
        return NOT_KNOWN


def _events_of_kinds(
    journal: Sequence[Line], sentences: Mapping[str, tuple[str, Callable[[Line], str]]]
) -> Iterator[RunEvent]:
    step = ""
    for line in journal:
        entry = str(line["entry"])
        if entry == Entry.INTENT:
            step = str(line.get("step", ""))
        if entry in sentences and (text := sentences[entry][1](line)):
            where = str(line.get("step", step))
            yield RunEvent(clock_time(line), theatre_time_s(line), sentences[entry][0], where, text)


def _repetition_text(line: Line) -> str:
    gone = _join_words(line.get("supersedes"))
    return f"Repeated; these results are no longer valid: {gone}" if gone else ""


def _acknowledgement_text(line: Line) -> str:
    who, device, fault = (str(line.get(field, "")) for field in ("by", "device", "fault"))
    code, words, _ = fault.partition(": ")
    what = code if words and code.isupper() else fault  # an error has been told when it came
    return f"{who} acknowledged the fault of the {device}: {what}"


def _restart_text(line: Line) -> str:
    """Describe the state in which a resuming program found the run."""
    begun, torn = line.get("begun"), line.get("torn_bytes")
    found = [f"the program ended before {begun} was complete"] if begun else []
    if torn:
        found.append("the last line of its journal was truncated and set aside")
    if LOST in line:
        found.append("its journal had lost its end")
    words = "; ".join(found)
    return f"{words[:1].upper()}{words[1:]}"


_SENTENCES: Mapping[str, tuple[str, Callable[[Line], str]]] = {
    Entry.RESULT: ("repetition", _repetition_text),
    Entry.REFUSED: ("refusal", lambda line: _join_words(line.get("unmet"))),
    Entry.FAILED: ("fault", lambda line: str(line.get("what", line.get("code", "")))),
    Entry.RESTED: ("rest", lambda line: str(line.get("reason", ""))),
    Entry.INTERRUPTED: ("fault", lambda _line: "The step was ended; the arm was stopped"),
    Entry.VOIDED: (
        "fault",
        lambda line: (
            f"{line.get('what', '')} These results are no longer valid: {_join_words(line.get('supersedes'))}"
        ),
    ),
    Entry.ACKNOWLEDGED: ("fault", _acknowledgement_text),
    Entry.DOUBTED: (
        "fault",
        lambda line: f"In doubt: {_join_words(line.get('steps'))}; {line.get('fault', '')}",
    ),
    Entry.RESTARTED: ("fault", _restart_text),
    Entry.ACCEPTED: ("repetition", lambda _line: "What was found after a restart was accepted"),
    Entry.MISREAD: ("repetition", lambda line: f"A wrong value was read back: {line.get('subject', '')}"),
}


def _join_words(value: JournalValue) -> str:
    if isinstance(value, list | tuple):
        return "; ".join(map(str, value))
    return "" if value is None else str(value)
