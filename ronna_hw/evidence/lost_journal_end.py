"""Lost end of a journal: lines that the run's event file still has, and records that no line names.

An event follows its journal line, so the file never has a line that was not written. Events confirm nothing;
but what they and orphaned records say of the work at a patient must not be forgotten.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from ronna_hw.bounded_input import LARGEST_JSON_BYTES, InputRefused, parse_json, read_bounded
from ronna_hw.evidence.journal_reading import ONLY_LEAVING, Entry, JournalValue, Line
from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.text import format_count, printable

EVENTS_FILE = "events.jsonl"
LOST = "lost"  # in a `restarted` line: how many lines, and what they say of the work through the guide
OF_THE_CHAIN = ("sequence", "previous", "host_time", "theatre_time_s")
MOST_LOST = 10_000  # a case has some thousands of lines
NAMED = 3  # steps in a sentence


def read_events(folder: Path) -> bytes:
    """Read a run's event file; empty if that is impossible.

    Of a run that goes on it must be read before the journal, which is ahead of it.
    """
    with suppress(OSError, InputRefused):
        return read_bounded(folder / EVENTS_FILE, LARGEST_JSON_BYTES, follow_links=False)
    return b""


def find_lost_lines(events: bytes, lines: Sequence[Line]) -> tuple[Line, ...]:
    """Find the journal lines in the event file that follow the last one in the journal, in order.

    Empty if the event file has no line of this journal, or the journal already names the loss.
    """
    lost: list[Line] = []
    for line in _iterate_backwards(events):
        number = line.get("sequence")
        if isinstance(number, int) and 0 <= number < len(lines) and _is_same(line, lines[number]):
            return () if any(LOST in later for later in lines[number:]) else tuple(reversed(lost))
        lost.append(line)
        if len(lost) > MOST_LOST:
            break
    return ()


def find_orphans(folder: Path, named: Collection[str]) -> tuple[str, ...]:
    """Find the records in a run's folder that the journal does not name, by identifier."""
    found = {path.stem for path in (folder / RECORDS_FOLDER).glob("*.json")}
    return tuple(sorted(found.difference(named)))


def describe_orphans(orphans: Sequence[str]) -> str:
    """Describe records that the journal does not name."""
    return f"records that the journal does not name, not used: {', '.join(map(printable, orphans))}"


def lost_as_plain(lost: Sequence[Line]) -> dict[str, JournalValue]:
    """Return the field of a `restarted` line for lost lines, or no field without any."""
    return {LOST: {"lines": len(lost), "work": list(select_work(lost))}} if lost else {}


def select_work(lost: Sequence[Line]) -> tuple[Line, ...]:
    """Select what lost lines say of the work through the guide."""
    return tuple(
        {field: value for field, value in line.items() if field not in OF_THE_CHAIN}
        for line in lost
        if _says_work(line)
    )


def describe_lost_end(lost: Sequence[Line], number: int) -> str:
    """Describe the lines lost after line `number` of a journal."""
    said = [*_name_steps(lost), *_name_work(lost)]
    if motions := sum(line["entry"] == Entry.MOTION for line in lost):
        said.append(format_count(motions, "motion"))
    more = f": {', '.join(said)}" if said else ""
    return (
        f"has lost its end: {EVENTS_FILE} has {format_count(len(lost), 'more line')} after line {number}, "
        f"until {printable(str(lost[-1].get('host_time')))}{more}"
    )


def describe_restart(line: Line) -> str:
    """Describe why a run was reopened, by its `restarted` line."""
    if ONLY_LEAVING in line:
        return "the run was taken up, only to go home or to acknowledge a fault,"
    return "the run was resumed"


def describe_former_losses(lines: Sequence[Line]) -> Iterator[str]:
    """Describe, in sentences, the losses with which a run was taken up."""
    for number, line in enumerate(lines):
        match line.get(LOST):
            case {"lines": int(count)}:
                yield (
                    f"the journal had lost {format_count(count, 'line')} when {describe_restart(line)} after "
                    f"its line {number}; what they say of the work was taken from {EVENTS_FILE}, the rest is "
                    "lost"
                )


def _iterate_backwards(events: bytes) -> Iterator[Line]:
    """Yield the journal lines in an event file, the last one first, without a torn end."""
    end = events.rfind(b"\n")
    while end > 0:
        begin = events.rfind(b"\n", 0, end) + 1
        if b'"journal"' in (content := events[begin:end]):
            with suppress(ValueError):
                match parse_json(content):
                    case {"what": {"kind": "journal", "line": {"entry": str(), "previous": str()} as line}}:
                        yield line
        end = begin - 1


def _says_work(line: Line) -> bool:
    """Return whether a line says something of the work, in the form in which a journal has it."""
    match line:
        case (
            {"entry": Entry.INSTRUMENT, "trajectory": str(), "inside": bool()}
            | {"entry": Entry.HELD, "trajectory": str(), "held": bool()}
            | {"entry": Entry.STAGE, "trajectory": str(), "task": str(), "done": bool()}
            | {"entry": Entry.STAGE, "trajectory": str(), "task": str(), "interrupted": str()}
            | {"entry": Entry.STAGE, "trajectory": str(), "stop": Mapping()}
            | {"entry": Entry.STAGE, "trajectory": str(), "doubted": True}
        ):
            return True
    return False


def _is_same(line: Line, journalled: Line) -> bool:
    return all(line.get(field) == journalled.get(field) for field in ("previous", "entry", "host_time"))


def _name_steps(lost: Sequence[Line]) -> Iterator[str]:
    if done := [printable(str(line.get("step"))) for line in lost if line["entry"] == Entry.RESULT]:
        yield f"{', '.join(done[:NAMED])}{' and more' if len(done) > NAMED else ''} done"


def _name_work(lost: Sequence[Line]) -> Iterator[str]:
    """Name the tasks begun by trajectory."""
    tasks: dict[str, list[str]] = {}
    for line in lost:
        if line["entry"] == Entry.STAGE and "task" in line:
            known = tasks.setdefault(printable(str(line.get("trajectory"))), [])
            if (task := printable(str(line["task"]))) not in known:
                known.append(task)
    for trajectory, begun in tasks.items():
        yield f"work at {trajectory} ({', '.join(begun)})"
