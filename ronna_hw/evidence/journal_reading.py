"""Reading of a journal and its hash chain, distinguishing crash damage from later changes.

A crash or a power loss tears the end: an unterminated line, or a last block of zeros. Nothing intact can
follow it. An intact line after a broken one means that someone changed or removed something.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from ronna_hw.bounded_input import parse_json, read_json_lines
from ronna_hw.errors import ErrorCode, RefusedError, RonnaError


class JournalCorrupt(RonnaError):
    """The hash chain of a journal is broken: a line was changed, lost or truncated in the middle."""

    code = "PRO-011"
    action = "Do not rely on this run; keep the folder as it is for analysis."


RUN_CHANGED = ErrorCode(
    "PRO-033",
    RefusedError,
    "Files of a run were changed after it ended.",
    "Do not rely on this run; keep the folder as it is. ronna-procedure verify RUN lists everything.",
)


JOURNAL_FILE = "journal.jsonl"
MOST_TORN_LINES = 1000  # in the block of zeros that a power loss leaves there are none or few
FIRST = "0" * 64  # hash named by the first line as that of its predecessor

JournalValue = str | float | bool | None | Sequence["JournalValue"] | Mapping[str, "JournalValue"]
Line = Mapping[str, JournalValue]  # one line, as read back

ONLY_LEAVING = "only_leaving"  # of a restart: to send the arm home or acknowledge a fault, and run no step


class Entry(StrEnum):
    """Kind of journal line."""

    OPENED = "opened"
    INTENT = "intent"
    RESULT = "result"
    REFUSED = "refused"
    CONFIRMATION = "confirmation"
    MISREAD = "misread"  # a read-back was wrong; the question stands
    MOTION = "motion"  # the intent of one motion
    MOVED = "moved"  # its outcome
    PLACED = "placed"  # the arm by its measured joints: home as set up, or not where the lines before say
    BASE = "base"  # of the assistant, as known from then on: needed for every way out
    INSTRUMENT = "instrument"  # goes into the guide, beyond the entry; or is confirmed to be out
    HELD = "held"  # by the assistant: an instrument may be in its holder from then on, or is out of it again
    STAGE = "stage"  # of the work through the guide: begun by hand, or confirmed to be done
    TRACKER = "tracker"  # moved since the localization, and followed
    LOOK = "look"  # at the room by the tracker, with all bodies in view and their covariances
    SCANNED = (
        "scanned"  # one look at the skin, kept until the scan is whole, which a line without a look says
    )
    WORK = "work"  # manual work, and its readings
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    VOIDED = "voided"  # results that are no longer valid: something has moved
    FINDING = "finding"  # something the operator should know that stops nothing
    RESTED = "rested"  # paused, or suspended by a guard; with the reason
    RESUMED = "resumed"  # continues after a pause
    DOUBTED = "doubted"  # results: by a fault of the arm, or another tool in place of the checked one
    SEAT = "seat"  # someone took the operator's seat at a console, or it became free
    ACKNOWLEDGED = "acknowledged"  # a device was recovered from its fault, and by whom
    HOME = "home"  # the intent to leave the head and park, outside the steps
    RESTARTED = "restarted"  # a program resumed a run that had ended or broken off
    FOUND = "found"  # what was read again and compared after a restart
    ACCEPTED = "accepted"  # by the operator: motion may follow
    CLOSED = "closed"


ENDS_OF_A_STEP = (Entry.RESULT, Entry.FAILED, Entry.INTERRUPTED)


def theatre_time_s(line: Line) -> float:
    """Return the theatre time of a journal line, or 0 if it has none."""
    value = line.get("theatre_time_s")
    return float(value) if isinstance(value, int | float) else 0.0


@dataclass(frozen=True)
class JournalChain:
    """Complete lines of a journal, with their length in bytes and the SHA-256 of the last one."""

    lines: tuple[Line, ...] = ()
    size: int = 0
    last: str = FIRST
    torn: bytes = b""  # anything after the last complete line

    @property
    def is_closed(self) -> bool:
        """Whether the last line of the journal closes the run."""
        return bool(self.lines) and self.lines[-1]["entry"] == Entry.CLOSED


def read_chain(path: Path) -> JournalChain:
    """Read the lines of a journal in order, and its truncated end; raises PRO-011 for a broken chain."""
    chain, broken = read_chain_until_break(path)
    if broken is not None:
        raise broken
    return chain


def read_chain_until_break(path: Path) -> tuple[JournalChain, JournalCorrupt | None]:
    """Read the chain up to the first broken line, and return any break. Raises INP-001, OSError."""
    content = read_json_lines(path, follow_links=False)
    lines: list[Line] = []
    size, broken = 0, None
    try:
        for line, end in _iterate_lines(content, path.name):
            lines.append(line)
            size = end
    except JournalCorrupt as problem:
        broken = problem
    last = content[:size].rfind(b"\n", 0, max(0, size - 1)) + 1
    return JournalChain(
        tuple(lines), size, _hash(content[last:size]) if lines else FIRST, b"" if broken else content[size:]
    ), broken


def read_journal(path: Path) -> Iterator[Line]:
    """Read the lines of a journal in order, omitting a truncated end; raises PRO-011 for a broken chain."""
    for line, _ in _iterate_lines(read_json_lines(path, follow_links=False), path.name):
        yield line


def _iterate_lines(content: bytes, name: str) -> Iterator[tuple[Line, int]]:
    """Yield each line that follows its predecessor in the chain, with the offset of its end."""
    number, begin, previous = 0, 0, FIRST
    while begin < len(content):
        end = content.find(b"\n", begin) + 1
        entry = _parse_line(content[begin:end]) if end else None
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


def _parse_line(line: bytes) -> dict[str, JournalValue] | None:
    try:
        entry = parse_json(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) and isinstance(entry.get("entry"), str) else None


def _is_torn(rest: bytes) -> bool:
    """Return whether a crash could have left these bytes after the last complete line."""
    *whole, last = rest.split(b"\n", MOST_TORN_LINES)
    if b"\0" not in rest and (whole or not last):
        return False
    return len(whole) < MOST_TORN_LINES and all(_parse_line(line) is None for line in whole)
