"""Lines of a theatre file's history: format, hash chain, and checked reading and appending.

An update is written ahead; once the theatre file is replaced, a line follows that it was carried out. Each
line has the hash of the line before it, and each text its own: an edited line is refused on reading. Only
whole lines missing at the end go unnoticed. A line cut off by a crash is named, and hides no other.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ValidationError

from procedures.engine.errors import HISTORY_CHANGED
from ronna_hw.bounded_input import read_bounded

LARGEST_HISTORY_BYTES = 100_000_000  # thousands of updates
BEGINNING = ""  # stands for the hash of the line before the first


class Update(BaseModel, frozen=True, extra="forbid"):
    """Line of an update, written before the theatre file is replaced."""

    time: str  # UTC
    by: str  # name given to the command, else the account
    account: str  # USER@COMPUTER
    command: str
    source: str = ""  # folder of the calibration
    changes: tuple[str, ...]  # such as "calibration.tool_tip: OLD -> NEW"
    sha256_before: str
    sha256_after: str
    former: str | None = None  # text of the file before, unless the line above has it
    text: str  # of the file after
    previous: str | None = None  # hash of the line before; None only before lines were chained


class CarriedOut(BaseModel, frozen=True, extra="forbid"):
    """Line that follows an update's once the theatre file was replaced."""

    carried_out: str  # UTC
    previous: str  # hash of the update's line


@dataclass(frozen=True)
class History:
    """Checked content of a history."""

    updates: tuple[Update, ...] = ()
    carried_out: frozenset[int] = frozenset()  # indices of updates with a line that says so
    cut_off: tuple[int, ...] = ()  # numbers of lines
    end_sha256: str = BEGINNING  # of the last line


def hash_bytes(content: bytes) -> str:
    """Return the SHA-256 of a line or a text."""
    return hashlib.sha256(content).hexdigest()


def read_history(path: Path) -> History:
    """Read and check a history, which may be missing. Raises PRO-046 if a line was changed since."""
    try:
        content = read_bounded(path, LARGEST_HISTORY_BYTES)
    except FileNotFoundError:
        return History()
    lines = content.removesuffix(b"\n").split(b"\n") if content else []
    updates: list[Update] = []
    carried_out: set[int] = set()
    cut_off: list[int] = []
    before, is_chained, above = BEGINNING, False, None
    for number, line in enumerate(lines, 1):
        entry = _parse(line)
        if entry is None:
            cut_off.append(number)
        elif entry.previous is not None or is_chained:
            is_chained = True
            _check_chain(path, number, before, entry)
        if isinstance(entry, Update):
            _check_texts(path, number, entry)
            updates.append(entry)
        elif entry is not None and isinstance(above, Update):
            carried_out.add(len(updates) - 1)
        before, above = hash_bytes(line), entry
    if cut_off and cut_off[-1] == len(lines) and content.endswith(b"\n"):
        raise HISTORY_CHANGED(
            f"line {len(lines)} of {path.name} was changed: it is complete, but neither an update nor its end"
        )
    return History(tuple(updates), frozenset(carried_out), tuple(cut_off), before)


def _parse(line: bytes) -> Update | CarriedOut | None:
    for kind in (Update, CarriedOut):
        try:
            return kind.model_validate_json(line)
        except ValidationError:
            continue
    return None


def _check_chain(path: Path, number: int, before: str, entry: Update | CarriedOut) -> None:
    if entry.previous == before:
        return
    changed = f"line {number - 1} of {path.name} was changed or moved" if number > 1 else "lines are missing"
    raise HISTORY_CHANGED(
        f"{changed} since line {number} of {path.name} was written",
        expected=f"SHA-256 {entry.previous or 'of no line before'}",
        got=before or "no line before",
    )


def _check_texts(path: Path, number: int, update: Update) -> None:
    for name, text, recorded in (
        ("former", update.former, update.sha256_before),
        ("text", update.text, update.sha256_after),
    ):
        if text is not None and (found := hash_bytes(text.encode())) != recorded:
            raise HISTORY_CHANGED(
                f"line {number} of {path.name} was changed: its {name} is not the recorded one",
                expected=f"SHA-256 {recorded}",
                got=found,
            )


def append(file: int, path: Path, entry: Update | CarriedOut) -> str:
    """Append a line to an open history, flush it to disk and return its hash.

    A line that cannot be written as a whole is withdrawn (OSError). One that a crash cut off is closed first.
    """
    line = entry.model_dump_json(exclude_defaults=True).encode()
    size = os.fstat(file).st_size
    is_open = size > 0 and os.pread(file, 1, size - 1) != b"\n"
    rest = (b"\n" if is_open else b"") + line + b"\n"
    try:
        while rest:  # a full disk takes a part, then refuses
            rest = rest[os.write(file, rest) :]
        os.fsync(file)
    except BaseException as problem:  # an interruption too must not leave half a line
        os.ftruncate(file, size)
        if isinstance(problem, OSError):
            raise OSError(problem.errno, problem.strerror, str(path)) from problem
        raise
    return hash_bytes(line)
