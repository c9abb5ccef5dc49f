"""The journal: written before anything happens, and again when it has happened.

Append-only JSON lines, each flushed to disk before the call returns, each naming the SHA-256 of the line
before it. Without a journal nothing moves: a write that fails raises PRO-003.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from procedures.engine.errors import JournalCorrupt, JournalNotWritable

JOURNAL_FILE = "journal.jsonl"
FIRST = "0" * 64  # what the first line names as the one before it


class Entry(StrEnum):
    """Kinds of journal lines."""

    OPENED = "opened"
    INTENT = "intent"
    RESULT = "result"
    REFUSED = "refused"
    CONFIRMATION = "confirmation"
    FAILED = "failed"
    INTERRUPTED = "interrupted"
    CLOSED = "closed"


class Journal:
    """The journal of one run."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL_FILE
        self._sequence = 0
        self._previous = FIRST
        try:
            self._file = os.open(
                self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o644
            )
            directory = os.open(folder, os.O_RDONLY)
            try:
                os.fsync(directory)
            finally:
                os.close(directory)
        except OSError as error:
            raise JournalNotWritable(f"cannot create {self.path.name}: {error.strerror}") from error

    def write(self, entry: Entry, theatre_time_s: float, **data: Any) -> None:
        """Append one line and return when it is on disk; raises PRO-003."""
        content = {
            "sequence": self._sequence,
            "previous": self._previous,
            "entry": entry.value,
            "host_time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "theatre_time_s": theatre_time_s,
            **data,
        }
        line = json.dumps(content, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        try:
            written = os.write(self._file, line)
            if written != len(line):
                raise OSError(0, "the line was cut")
            os.fdatasync(self._file)
        except OSError as error:
            raise JournalNotWritable(f"cannot write {self.path.name}: {error.strerror}") from error
        self._sequence += 1
        self._previous = hashlib.sha256(line).hexdigest()

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """The lines of a journal, in order; raises PRO-011 when the chain is broken.

    One torn last line, as a crash leaves it, is not an error and is not returned.
    """
    previous = FIRST
    content = path.read_bytes()
    lines = content.splitlines(keepends=True)
    for number, line in enumerate(lines):
        if not line.endswith(b"\n") and number == len(lines) - 1:
            return
        try:
            entry = json.loads(line)
        except ValueError as error:
            raise JournalCorrupt(f"line {number + 1} of {path.name} is not JSON") from error
        if entry.get("previous") != previous or entry.get("sequence") != number:
            raise JournalCorrupt(f"line {number + 1} of {path.name} does not follow the line before it")
        previous = hashlib.sha256(line).hexdigest()
        yield entry
