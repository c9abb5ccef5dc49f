"""One program at a time has the devices of a theatre file; a note next to the file says for which run.

Both files are locked: the note survives an editor that replaces the theatre file, and the theatre file is
there for a user who can neither write nor make the note.
"""

from __future__ import annotations

import fcntl
import os
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError

from procedures.engine.errors import TheatreInUse, TheatreNotNoted
from procedures.journal.journal import JOURNAL_FILE, Entry
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.host.port_users import PortUser, holder_of_lock

READABLE_BY_ALL = 0o444


class TheatreNote(BaseModel):
    """Content of the lock file: the last run that had the devices, and the last before it that moved."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    run: Path | None = None
    pid: int | None = None
    lines_before: NonNegativeInt = 0  # of its journal: what it moved before it had the devices does not count
    moved_before: Path | None = None

    @property
    def last_moved(self) -> Path | None:
        """The last run that moved the arm, if its journal can still be read."""
        moved = self.run is not None and _may_have_moved(self.run, self.lines_before)
        return self.run if moved else self.moved_before


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

    def advice(self, then: str) -> str:
        """What to do instead of ending it; `then` when it has ended."""
        alone = "Leave it alone: its arm may be at a patient."
        if self.run is None:
            return f"{alone} {then.capitalize()} when it has ended."
        watch = f"Follow it with ronna-procedure watch {shlex.quote(str(self.run))}"
        return f"{alone} {watch}; {then} when it has ended."


@contextmanager
def held_theatre(theatre: Path, run: Path | None, *, only_leaving: bool = False) -> Iterator[Path | None]:
    """Hold the devices of a theatre file for a run; yields the last run before it that moved their arm.

    Raises PRO-043 while another program has them, and PRO-045 if the next run could not know of this one,
    unless it is `only_leaving`: nothing keeps an arm over the head.
    """
    if user := _user_of_own_run(theatre):
        raise _in_use(user)
    path = _lock_file(theatre)
    with ExitStack() as stack:
        noted = _opened(path, os.O_RDWR | os.O_CREAT)
        for file in (_opened(path) if noted is None else noted, _opened(theatre)):
            if file is not None:
                stack.callback(os.close, file)
                _lock(file, path, needed=noted in (None, file))
        if noted is not None:
            with suppress(OSError):  # of another user; it names a run, so all may see who has the theatre
                os.fchmod(noted, os.fstat(noted).st_mode | READABLE_BY_ALL)
        moved = read_note(path).last_moved
        note = TheatreNote(
            run=run and run.resolve(),
            pid=os.getpid(),
            lines_before=0 if run is None else _journal_lines(run),
            moved_before=moved,
        )
        if not (_written(noted, note) or only_leaving):
            raise TheatreNotNoted(
                f"cannot write {path}: a later run could not know that this one left the arm away from home"
            )
        yield moved


def _opened(path: Path, how: int = os.O_RDONLY) -> int | None:
    """None for a file, or a folder, of another user, and for one that is not there."""
    try:
        return os.open(path, how | os.O_CLOEXEC, 0o666)
    except OSError:
        return None


def _lock(file: int, path: Path, *, needed: bool) -> None:
    """Raise PRO-043 while another program has locked it; another failure counts only if it is `needed`."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise _in_use(_user(path, file)) from None
    except OSError:  # a network file system may lock only what is open for writing
        if needed:
            raise


def _written(file: int | None, note: TheatreNote) -> bool:
    if file is None:
        return False
    try:
        os.ftruncate(file, os.pwrite(file, note.model_dump_json().encode(), 0))
        os.fdatasync(file)
    except OSError:
        return False
    return True


def theatre_user(theatre: Path) -> TheatreUser | None:
    """Who has the devices of a theatre file now, as far as this user may see."""
    if user := _user_of_own_run(theatre):
        return user
    path = _lock_file(theatre)
    for file in (_opened(path), _opened(theatre)):
        if file is None:
            continue
        try:  # looked up, not tried: a lock for a moment would refuse a run that begins in it
            if holder_of_lock(file) is not None:
                return _user(path, file)
        finally:
            os.close(file)
    return None


def last_moved(theatre: Path) -> Path | None:
    """The last run that moved the arm of a theatre file, whether or not a program has its devices."""
    return read_note(_lock_file(theatre)).last_moved


def unwritable_note(theatre: Path) -> Path | None:
    """The note that this user may not write, as `held_theatre` needs to; None if it may."""
    path = _lock_file(theatre)
    return None if os.access(path if path.exists() else path.parent, os.W_OK) else path


def last_runs(theatre: Path) -> tuple[Path, ...]:
    """The last run that moved the arm of a theatre file, and the last that had its devices."""
    note = read_note(_lock_file(theatre))
    return tuple(run for run in (note.last_moved, note.run) if run is not None)


def require_free_theatre(theatre: Path) -> None:
    """Raise PRO-043 while another program has the devices, before anyone is asked to prepare anything."""
    if user := theatre_user(theatre):
        raise _in_use(user)


def _in_use(user: TheatreUser) -> TheatreInUse:
    return TheatreInUse(user.seen, action=user.advice("start again"))


def _user(path: Path, file: int) -> TheatreUser:
    """The holder of the lock, and its run if the note is its own."""
    note, holder = read_note(path), holder_of_lock(file)
    return TheatreUser(note.run if holder is not None and holder.pid == note.pid else None, holder)


def _user_of_own_run(theatre: Path) -> TheatreUser | None:
    """A simulated theatre is made in the folder of its run, and used by that run alone."""
    run = theatre.resolve().parent.parent
    if not (run / JOURNAL_FILE).is_file():
        return None
    try:
        folder = os.open(run, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        holder = holder_of_lock(folder)
    finally:
        os.close(folder)
    return None if holder is None else TheatreUser(run, holder)


def _lock_file(theatre: Path) -> Path:
    theatre = theatre.resolve()
    return theatre.with_name(f".{theatre.name}.in-use")


def read_note(path: Path) -> TheatreNote:
    """What a lock file says; nothing if it cannot be read."""
    try:
        return TheatreNote.model_validate_json(read_json_bytes(path))
    except (OSError, RonnaError, ValidationError):
        return TheatreNote()


def _may_have_moved(run: Path, lines_before: int) -> bool:
    """Also one whose journal cannot be read, or has lost its end; not one whose folder was removed, as of a
    refused run."""
    try:
        chain = read_chain(run / JOURNAL_FILE)
    except (OSError, RonnaError):
        return is_there(run)
    return bool(chain.torn) or any(line["entry"] == Entry.MOTION for line in chain.lines[lines_before:])


def is_there(run: Path) -> bool:
    """Whether its folder is there, or in a place that is hidden from this user."""
    try:
        return run.exists()
    except OSError:
        return True


def _journal_lines(run: Path) -> int:
    """How many lines its journal has; 0 if it cannot be read."""
    try:
        return len(read_chain(run / JOURNAL_FILE).lines)
    except (OSError, RonnaError):
        return 0
