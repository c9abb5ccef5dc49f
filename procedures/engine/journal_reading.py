"""Reads a journal back and checks its chain. What a crash may leave at its end is told from what was changed.

A crash or a loss of power tears the end: a line without its end, or a last block of zeros. Nothing whole can
follow it. A whole line after a broken one means that somebody changed or removed something.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from procedures.engine.errors import JournalCorrupt
from ronna_hw.bounded_input import parse_json, read_json_lines

FIRST = "0" * 64  # what the first line names as the one before it

JournalValue = str | float | bool | None | Sequence["JournalValue"] | Mapping[str, "JournalValue"]
Line = Mapping[str, JournalValue]  # one line, as it is read back


@dataclass(frozen=True)
class Chain:
    """What a journal holds: its whole lines, how many bytes they take, the SHA-256 of the last of them."""

    lines: tuple[Line, ...] = ()
    size: int = 0
    last: str = FIRST
    torn: bytes = b""  # what follows the last whole line


def read_chain(path: Path) -> Chain:
    """A journal's lines in order, and what is torn at its end; raises PRO-011 when the chain is broken."""
    content = read_json_lines(path)
    lines: list[Line] = []
    size = 0
    for line, end in _whole_lines(content, path.name):
        lines.append(line)
        size = end
    last = content[:size].rfind(b"\n", 0, max(0, size - 1)) + 1
    return Chain(tuple(lines), size, _hash(content[last:size]) if lines else FIRST, content[size:])


def read_journal(path: Path) -> Iterator[Line]:
    """The lines of a journal, in order, without a torn end; raises PRO-011 where the chain is broken."""
    for line, _ in _whole_lines(read_json_lines(path), path.name):
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
            what = "is not JSON" if entry is None else "does not follow the line before it"
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
    return entry if isinstance(entry, dict) else None


def _is_torn(rest: bytes) -> bool:
    """Whether a crash can have left this after the last whole line."""
    *whole, last = rest.split(b"\n")
    if any(_parsed(line) is not None for line in whole):
        return False
    return b"\0" in rest or (not whole and bool(last))
