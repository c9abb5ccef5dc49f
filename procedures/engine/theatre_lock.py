"""One program at a time has the devices of a theatre file; it says beside the file for which run."""

from __future__ import annotations

import fcntl
import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from procedures.engine.errors import TheatreInUse
from procedures.journal.journal import JOURNAL_FILE, Entry
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.host.port_users import PortUser, holder_of_lock


class TheatreNote(BaseModel):
    """Content of the lock file: the last run that had the devices, and the last before it that moved."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    run: Path | None = None
    pid: int | None = None
    moved_before: Path | None = None

    @property
    def last_moved(self) -> Path | None:
        """The last run that moved the arm, if its journal can still be read."""
        return self.run if self.run is not None and _has_moved(self.run) else self.moved_before


@dataclass(frozen=True)
class TheatreUser:
    """The program that has the devices now, as far as this user may see it."""

    run: Path | None
    holder: PortUser | None

    @property
    def seen(self) -> str:
        """Which run uses the theatre, and its process id."""
        number = "" if self.holder is None else f" (pid {self.holder.pid})"
        return f"{'another program' if self.run is None else self.run.name}{number} is using this theatre"

    @property
    def advice(self) -> str:
        """What to do instead of ending it; the caller adds when to try again."""
        alone = "Leave it alone: its arm may be at a patient. "
        if self.run is None:
            return alone
        return f"{alone}Follow it with ronna-procedure watch {shlex.quote(str(self.run))}; "


@contextmanager
def held_theatre(theatre: Path, run: Path | None) -> Iterator[Path | None]:
    """Hold the devices of a theatre file for a run; yields the last run before it that moved their arm.

    Raises PRO-043 while another program has them.
    """
    path = _lock_file(theatre)
    try:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError:  # the file of another user, or a folder that cannot be written: held without a note
        file = os.open(path if path.exists() else theatre, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _in_use(_user(path, file)) from None
        last_moved = read_note(path).last_moved
        note = TheatreNote(run=run and run.resolve(), pid=os.getpid(), moved_before=last_moved)
        with suppress(OSError):
            os.ftruncate(file, 0)
            os.pwrite(file, note.model_dump_json().encode(), 0)
        yield last_moved
    finally:
        os.close(file)


def theatre_user(theatre: Path) -> TheatreUser | None:
    """Who has the devices of a theatre file now."""
    path = _lock_file(theatre)
    try:
        file = os.open(path if path.exists() else theatre, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return _user(path, file)
    except OSError:  # a file system without locks
        return None
    finally:
        os.close(file)
    return None


def require_free_theatre(theatre: Path) -> None:
    """Raise PRO-043 while another program has the devices, before anyone is asked to prepare anything."""
    if user := theatre_user(theatre):
        raise _in_use(user)


def _in_use(user: TheatreUser) -> TheatreInUse:
    return TheatreInUse(user.seen, action=f"{user.advice}start again when it has ended.")


def _user(path: Path, file: int) -> TheatreUser:
    """The holder of the lock, and its run if the note is its own."""
    note, holder = read_note(path), holder_of_lock(file)
    return TheatreUser(note.run if holder is None or holder.pid == note.pid else None, holder)


def _lock_file(theatre: Path) -> Path:
    theatre = theatre.resolve()
    return theatre.with_name(f".{theatre.name}.in-use")


def read_note(path: Path) -> TheatreNote:
    """What a lock file says; nothing if it cannot be read."""
    try:
        return TheatreNote.model_validate_json(read_json_bytes(path))
    except (OSError, RonnaError, ValidationError):
        return TheatreNote()


def _has_moved(run: Path) -> bool:
    with suppress(OSError, RonnaError):
        return any(line["entry"] == Entry.MOTION for line in read_chain(run / JOURNAL_FILE).lines)
    return False
