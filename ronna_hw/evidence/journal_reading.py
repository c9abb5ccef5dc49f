"""Reads a journal back and checks its chain. Damage from a crash is distinguished from later changes.

A crash or a loss of power tears the end: a line without its end, or a last block of zeros. Nothing whole can
follow it. A whole line after a broken one means that someone changed or removed something.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.evidence.errors import JournalCorrupt

JOURNAL_FILE = "journal.jsonl"
MOST_TORN_LINES = 1000  # in a block of zeros that a loss of power leaves, there are none or few
FIRST = "0" * 64  # what the first line names as the one before it

JournalValue = str | float | bool | None | Sequence["JournalValue"] | Mapping[str, "JournalValue"]
Line = Mapping[str, JournalValue]  # one line, as it is read back


class Entry(StrEnum):
    """Kinds of journal lines."""

    OPENED = "opened"
    INTENT = "intent"
    RESULT = "result"
    REFUSED = "refused"
    CONFIRMATION = "confirmation"
    MISREAD = "misread"  # what was to be read back was not; the question stands
    MOTION = "motion"  # the intent of one motion
    MOVED = "moved"  # what came of it
    INSTRUMENT = "instrument"  # goes into the guide, beyond the entry; or is confirmed to be out
    STAGE = "stage"  # of the work through the guide: hands begin it, or it is confirmed to be done
    WORK = "work"  # what hands did, and what they read off
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    VOIDED = "voided"  # results that no longer hold: something has moved
    FINDING = "finding"  # something the operator should know that stops nothing
    RESTED = "rested"  # paused, or suspended by a guard; with the reason
    RESUMED = "resumed"  # goes on after a rest
    DOUBTED = "doubted"  # the arm was in fault: registrations must be confirmed, the tool checked again
    SEAT = "seat"  # somebody took the operator's seat at a console, or it became free
    ACKNOWLEDGED = "acknowledged"  # a device was recovered from its fault, by whom
    HOME = "home"  # the intent to leave the head and park, outside the steps
    RESTARTED = "restarted"  # a program took up a run that had ended or broken off
    FOUND = "found"  # what was read again and compared after a restart
    ACCEPTED = "accepted"  # the operator accepted it: motion may follow
    CLOSED = "closed"


ENDS_OF_A_STEP = (Entry.RESULT, Entry.FAILED, Entry.INTERRUPTED)


def theatre_time_s(line: Line) -> float:
    """When a line was written; 0 where it does not say so."""
    value = line.get("theatre_time_s")
    return float(value) if isinstance(value, int | float) else 0.0


@dataclass(frozen=True)
class Chain:
    """What a journal holds: its whole lines, how many bytes they take, the SHA-256 of the last of them."""

    lines: tuple[Line, ...] = ()
    size: int = 0
    last: str = FIRST
    torn: bytes = b""  # what follows the last whole line


def read_chain(path: Path) -> Chain:
    """A journal's lines in order, and what is torn at its end; raises PRO-011 when the chain is broken."""
    chain, broken = chain_until_broken(path)
    if broken is not None:
        raise broken
    return chain


def chain_until_broken(path: Path) -> tuple[Chain, JournalCorrupt | None]:
    """As `read_chain`, with what comes before a broken line, and the break. Raises INP-001, OSError."""
    content = read_json_lines(path, linked=False)
    lines: list[Line] = []
    size, broken = 0, None
    try:
        for line, end in _whole_lines(content, path.name):
            lines.append(line)
            size = end
    except JournalCorrupt as problem:
        broken = problem
    last = content[:size].rfind(b"\n", 0, max(0, size - 1)) + 1
    return Chain(
        tuple(lines), size, _hash(content[last:size]) if lines else FIRST, b"" if broken else content[size:]
    ), broken


def read_journal(path: Path) -> Iterator[Line]:
    """The lines of a journal, in order, without a torn end; raises PRO-011 where the chain is broken."""
    for line, _ in _whole_lines(read_json_lines(path, linked=False), path.name):
        yield line


def _whole_lines(content: bytes, name: str) -> Iterator[tuple[Line, int]]:
    """Every line that follows the one before it, and where it ends."""
    number, begin, previous = 0, 0, FIRST
    while begin < len(content):
        end = content.find(b"\n", begin) + 1
        entry = _parsed(content[begin:end]) if end else None
        if entry is None or entry.get("previous") != previous or entry.get("sequence") != number:
            if _is_torn(content[begin:]):
                return
            what = "is not a journal line" if entry is None else "does not follow the line before it"
            raise JournalCorrupt(f"line {number + 1} of {name} {what}")
        yield entry, end
        previous = _hash(content[begin:end])
        number, begin = number + 1, end


def _hash(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()


def _parsed(line: bytes) -> dict[str, JournalValue] | None:
    try:
        entry = parse_json(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) and isinstance(entry.get("entry"), str) else None


def _is_torn(rest: bytes) -> bool:
    """Whether a crash can have left this after the last whole line."""
    *whole, last = rest.split(b"\n", MOST_TORN_LINES)
    if b"\0" not in rest and (whole or not last):
        return False
    return len(whole) < MOST_TORN_LINES and all(_parsed(line) is None for line in whole)
