"""Journal of a run, written before each action begins and after it ends.

Append-only JSON lines, each flushed to disk before the call returns, each naming the SHA-256 of the line
before it. Without a journal nothing moves: a write that fails raises PRO-003 and leaves no part of its line.
How a step or the run ended is recorded even on a full disk: room for it is held in a file of its own. A block
that a power loss empties costs the lines since the last result at most.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from procedures.journal.errors import JournalNotWritable, RunDeleted
from ronna_hw.evidence.journal_reading import (
    ENDS_OF_A_STEP,
    FIRST,
    JOURNAL_FILE,
    ONLY_LEAVING,
    Entry,
    JournalChain,
    JournalValue,
    Line,
    read_journal,
    theatre_time_s,
)
from ronna_hw.evidence.manifest import ROOM_FILE
from ronna_hw.host.files import sync_folder

__all__ = [
    "ENDS_OF_A_STEP",
    "JOURNAL_FILE",
    "OF_EVERY_LINE",
    "ONLY_LEAVING",
    "TORN_FILE",
    "Entry",
    "Journal",
    "JournalValue",
    "Line",
    "read_journal",
    "theatre_time_s",
]

TORN_FILE = "journal.torn"  # torn end of a journal, cut off when the run is resumed
ROOM_BYTES = 1 << 20  # a last line names every file of the run and every slice of its CT, some 150 bytes each
BLOCK_BYTES = 4096  # what a power loss may tear or empty at the end of a file
# A result, or where an instrument is, must not share a block with lines that follow it: spaces fill the rest.
FILLING = (Entry.RESULT, Entry.INSTRUMENT, Entry.HELD)
OF_EVERY_LINE = ("sequence", "previous", "entry", "host_time", "theatre_time_s")
ENDINGS = (Entry.FAILED, Entry.INTERRUPTED, Entry.CLOSED)


class _Chain(NamedTuple):
    """Length and last hash of the journal file."""

    size: int  # bytes
    lines: int
    last: str  # SHA-256 of the last line


class Journal:
    """Journal of one run."""

    def __init__(self, folder: Path, on_line: Callable[[bytes], None] = lambda _line: None) -> None:
        """Create the journal of a run; `on_line` is called with every written line."""
        self._open(folder, on_line, os.O_CREAT | os.O_EXCL, _Chain(0, 0, FIRST))
        with self._close_on_error():
            _sync_folder(folder)

    @classmethod
    def reopen_run(
        cls, folder: Path, chain: JournalChain, on_line: Callable[[bytes], None] = lambda _line: None
    ) -> Journal:
        """Reopen the journal of an interrupted run, setting aside a torn end.

        Raises PRO-003 if it cannot be written.
        """
        journal = cls.__new__(cls)
        journal._open(folder, on_line, 0, _Chain(chain.size, len(chain.lines), chain.last))
        with journal._close_on_error():
            if chain.torn:
                journal._set_aside_torn_end(chain.torn)
            journal._hold_room()  # a resumed run can be closed again
        return journal

    @contextlib.contextmanager
    def _close_on_error(self) -> Iterator[None]:
        try:
            yield
        except JournalNotWritable:
            self.close()
            raise

    def _set_aside_torn_end(self, torn: bytes) -> None:
        """Move a torn end into a file beside the journal."""
        folder = self.path.parent
        try:
            with (folder / TORN_FILE).open("ab") as torn_file:
                torn_file.write(torn + b"\n")
                torn_file.flush()
                os.fsync(torn_file.fileno())
            _sync_folder(folder)
            os.ftruncate(self._file, self._chain.size)
            os.fsync(self._file)
        except OSError as error:
            raise self._not_writable(error.strerror) from error

    def _open(self, folder: Path, on_line: Callable[[bytes], None], flags: int, chain: _Chain) -> None:
        self.path = folder / JOURNAL_FILE
        self._on_line = on_line
        self._chain = chain
        self._pending = b""  # a line that is being written
        self._failure = ""  # why nothing more can be written
        self.closed = False
        try:
            self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC | flags, 0o666)
        except OSError as error:
            raise JournalNotWritable(f"cannot open {self.path.name}: {error.strerror}") from error
        self._room = folder / ROOM_FILE

    def write(self, entry: Entry, theatre_time_s: float, **data: JournalValue) -> None:
        """Append one line and return when it is on disk. Raises PRO-003."""
        self._append(entry, theatre_time_s, data, durable=True)

    def note(self, entry: Entry, theatre_time_s: float, **data: JournalValue) -> None:
        """Append one line, which reaches the disk with the next `write`. Raises PRO-003.

        Sufficient for past events, never for intents.
        """
        self._append(entry, theatre_time_s, data, durable=False)

    def _append(
        self, entry: Entry, theatre_time_s: float, data: Mapping[str, JournalValue], *, durable: bool
    ) -> None:
        if self.closed:
            raise self._not_writable("the journal is closed")
        if self._failure:
            raise self._not_writable(self._failure)
        if (deletion := self.deletion) is not None:
            raise deletion
        self._settle_pending()
        if entry is Entry.INTENT:
            self._hold_room()
        content = {
            "sequence": self._chain.lines,
            "previous": self._chain.last,
            "entry": entry.value,
            "host_time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "theatre_time_s": theatre_time_s,
            **data,
        }
        line = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        if entry in FILLING:
            line += b" " * (-(self._chain.size + len(line) + 1) % BLOCK_BYTES)
        line += b"\n"
        try:
            self._write_line(line, durable=durable)
        except JournalNotWritable:
            if entry not in ENDINGS or self._failure or not self._room.exists():
                raise
            self._room.unlink()
            self._write_line(line, durable=durable)

    def _write_line(self, line: bytes, *, durable: bool) -> None:
        """Write a line and flush it, removing it again if the flush fails."""
        self._pending = line
        try:
            os.write(self._file, line)
            if durable:
                os.fdatasync(self._file)
        except OSError as error:
            self._take_back()
            raise self._not_writable(error.strerror) from error
        self._settle_pending()

    def _take_back(self) -> None:
        """Remove an unflushed line. If that fails, the journal accepts no further lines."""
        try:
            if os.fstat(self._file).st_size != self._chain.size:
                os.ftruncate(self._file, self._chain.size)
        except OSError as error:
            self._failure = f"a line was not flushed, and {error.strerror}"
            raise self._not_writable(self._failure) from error
        finally:
            self._pending = b""

    def _hold_room(self) -> None:
        """Reserve disk space for a step's outcome before the step begins."""
        if self._room.exists():
            return
        try:
            file = os.open(self._room, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
            try:
                os.posix_fallocate(file, 0, ROOM_BYTES)
            finally:
                os.close(file)
        except OSError as error:
            self._room.unlink(missing_ok=True)
            raise self._not_writable(error.strerror, expected=f"room for {ROOM_BYTES} bytes more") from error

    def _settle_pending(self) -> None:
        """Count the pending line if it is complete in the file, otherwise remove its fragment.

        A signal may end a write at any point, also when the line is there and not counted yet. So the content
        of the file decides, and chain and pending line change by one assignment each. A line is handed on
        when it is counted, also one whose writing was interrupted.
        """
        if not self._pending:
            return
        chain, line = self._chain, self._pending
        size = os.fstat(self._file).st_size
        if size == chain.size + len(line):
            self._chain = _Chain(size, chain.lines + 1, hashlib.sha256(line).hexdigest())
            self._pending = b""
            self._on_line(line)
        elif size != chain.size:
            try:
                os.ftruncate(self._file, chain.size)
            except OSError as error:
                raise self._not_writable(f"the line was cut, and {error.strerror}") from error
            self._pending = b""
            raise self._not_writable("the line was cut: the disk is full")
        else:
            self._pending = b""

    def _not_writable(self, reason: str | None, expected: str | None = None) -> JournalNotWritable:
        return JournalNotWritable(f"cannot write {self.path.name}: {reason}", expected=expected)

    @property
    def deletion(self) -> RunDeleted | None:
        """Error if the file was deleted, or None. Writes to a deleted file succeed, and are lost."""
        if self.closed or os.stat(self._file).st_nlink:
            return None
        folder = self.path.parent
        lost = self.path if folder.is_dir() else f"the run folder {folder}"
        return RunDeleted(f"{lost} was deleted while the run was open")

    def close(self) -> None:
        """Close the file."""
        self.closed = True
        os.close(self._file)
        with contextlib.suppress(OSError):
            self._room.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Sync a folder to make its directory entries durable. Raises PRO-003."""
    try:
        sync_folder(folder)
    except OSError as error:
        raise JournalNotWritable(f"cannot write into {folder.name}: {error.strerror}") from error
