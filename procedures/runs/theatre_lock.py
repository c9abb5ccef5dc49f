"""Theatre lock: one program at a time may use the devices, for the run named in the notes of the arms.

Notes and theatre file are all locked. A note belongs to its arm, whatever the file is called and whichever
role the arm has there. The file serves a user who can neither write nor create the note.
"""

from __future__ import annotations

import fcntl
import os
import shlex
import stat
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from procedures.engine.errors import TheatreInUse, TheatreNotNoted
from procedures.journal.journal import JOURNAL_FILE
from procedures.runs.arm_notes import ROLES, FormerRun, TheatreNote, find_former_run, note_paths, read_note
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.host.port_users import PortUser, find_folder_holder, find_lock_holder

NOTE = os.O_NOFOLLOW  # where everyone may write, a link may lead to any file of whoever opens it
READABLE_BY_ALL = 0o444
WRITABLE_BY_ALL = 0o1777  # a folder in which everyone may make files, and remove only their own


@dataclass(frozen=True)
class TheatreUser:
    """The program using a theatre, and its run if known to this user."""

    run: Path | None
    holder: PortUser | None

    @property
    def seen(self) -> str:
        """Sentence stating which run and process is using the theatre."""
        number = "" if self.holder is None else f" (pid {self.holder.pid})"
        return f"{'another program' if self.run is None else self.run.name}{number} is using this theatre"

    def advice(self, then: str) -> str:
        """Return advice not to disturb the program; `then` is what to do once it has ended."""
        alone = "Leave it alone: its arm may be at a patient."
        if self.run is None:
            return f"{alone} {then.capitalize()} when it has ended."
        watch = f"Follow it with ronna-procedure watch {shlex.quote(str(self.run))}"
        return f"{alone} {watch}; {then} when it has ended."


@contextmanager
def hold_theatre(
    theatre: Path, run: Path | None, roles: Collection[str] = ROLES, *, only_leaving: bool = False
) -> Iterator[tuple[TheatreNote, ...]]:
    """Lock a theatre file's arms in these roles for a run; yield the notes left by earlier runs.

    Raises PRO-043 while another program has them, PRO-047 while the instrument of another run may be inside,
    and PRO-045 if the next run could not know of this one.
    With `only_leaving` the latter is accepted: nothing keeps an arm over the head.
    """
    if user := _find_user_of_own_run(theatre):
        raise _build_in_use_error(user)
    with ExitStack() as stack:
        paths = note_paths(theatre, roles)
        notes = {path: _open_note(path) for path in paths}
        opened = [(path, _open_own(path, NOTE) if file is None else file) for path, file in notes.items()]
        opened.append((next(iter(notes)), own := _open_own(theatre)))
        for _, file in opened:
            if file is not None:
                stack.callback(os.close, file)
        for path, file in opened:
            if file is not None:
                _lock(file, path, needed=file is not own or None in notes.values())
        before = {path: read_note(path).with_outcome() for path in notes}
        for note in before.values():
            find_former_run(note, run).require_no_instrument()
        lines = 0 if run is None else _count_journal_lines(run)
        mine = {"run": run and run.resolve(), "pid": os.getpid(), "lines_before": lines}
        noted = {path: note.model_copy(update=mine | {"role": paths[path]}) for path, note in before.items()}
        for path, file in notes.items():
            if file is not None:
                with suppress(OSError):  # of another user; it names a run, so all may see who has the theatre
                    os.fchmod(file, (os.fstat(file).st_mode | READABLE_BY_ALL) & ~stat.S_IWOTH)
            if not (_write_note(file, noted[path]) or only_leaving):
                raise TheatreNotNoted(
                    f"cannot write {path}: a later run would not know that this one left the arm away "
                    "from home"
                )
        try:
            yield tuple(before.values())
        finally:  # from here on its folder may be moved
            for path, file in notes.items():
                _write_note(file, noted[path].with_outcome())


def _open_note(path: Path) -> int | None:
    with suppress(OSError):  # it is there, or nothing can be made there
        path.parent.mkdir()
        path.parent.chmod(WRITABLE_BY_ALL)
    # Where everyone may write, a file of another user can be opened only without making it.
    made = _open_own(path, NOTE | os.O_RDWR | os.O_CREAT)
    return _open_own(path, NOTE | os.O_RDWR) if made is None else made


def _open_own(path: Path, flags: int = os.O_RDONLY) -> int | None:
    """Open a file or folder, or return None if it is missing or this user may not open it."""
    try:
        return os.open(path, flags | os.O_CLOEXEC, 0o664)  # a note that all may write is not believed
    except OSError:
        return None


def _lock(file: int, path: Path, *, needed: bool) -> None:
    """Lock an open file. Raises PRO-043 if another program has it locked, other errors only if `needed`."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise _build_in_use_error(_identify_user(path, file)) from None
    except OSError:  # a network file system may lock only what is open for writing
        if needed:
            raise


def _write_note(file: int | None, note: TheatreNote) -> bool:
    if file is None:
        return False
    try:
        os.ftruncate(file, os.pwrite(file, note.model_dump_json().encode(), 0))
        os.fdatasync(file)
    except OSError:
        return False
    return True


def find_theatre_user(theatre: Path, roles: Collection[str] = ROLES) -> TheatreUser | None:
    """Return the current user of a theatre file's arms, or None, as far as permissions allow."""
    if user := _find_user_of_own_run(theatre):
        return user
    paths = tuple(note_paths(theatre, roles))
    for path, lockable, flags in (*((path, path, NOTE) for path in paths), (paths[0], theatre, os.O_RDONLY)):
        if (file := _open_own(lockable, flags)) is None:
            continue
        try:  # looked up, not tried: a lock for a moment would refuse a run that begins in it
            if find_lock_holder(file) is not None:
                return _identify_user(path, file)
        finally:
            os.close(file)
    return None


def read_last_notes(theatre: Path, roles: Collection[str] = ROLES) -> tuple[TheatreNote, ...]:
    """Return the notes about the arms of a theatre, whether or not a program holds its devices."""
    return tuple(read_note(path).with_outcome() for path in note_paths(theatre, roles))


def read_former_run(theatre: Path, run: Path | None = None, roles: Collection[str] = ROLES) -> FormerRun:
    """Return how another run than `run` left an arm of a theatre; empty if at home with nothing inside."""
    found = (find_former_run(note, run) for note in read_last_notes(theatre, roles))
    return next((one for one in found if one != FormerRun()), FormerRun())


def find_unwritable_note(theatre: Path) -> Path | None:
    """Return the path of a note that `hold_theatre` needs to write if this user may not, else None."""
    for path in note_paths(theatre):
        nearest_existing = next(place for place in (path, *path.parents) if place.exists())
        if not os.access(nearest_existing, os.W_OK):
            return path
    return None


def list_last_runs(theatre: Path) -> tuple[Path, ...]:
    """Return the last runs that moved a theatre's arms, then the last that held its devices."""
    notes = read_last_notes(theatre)
    runs = (*(note.moved_before for note in notes), *(note.run for note in notes))
    return tuple(dict.fromkeys(run for run in runs if run is not None))


def require_ready_theatre(theatre: Path, run: Path | None = None, roles: Collection[str] = ROLES) -> None:
    """Raise PRO-043 or PRO-047 as `hold_theatre` would for `run`, before anyone prepares anything."""
    require_free_theatre(theatre, roles)
    for note in read_last_notes(theatre, roles):
        find_former_run(note, run).require_no_instrument()


def require_free_theatre(theatre: Path, roles: Collection[str] = ROLES) -> None:
    """Raise PRO-043 while another program holds the arms, before anyone prepares anything."""
    if user := find_theatre_user(theatre, roles):
        raise _build_in_use_error(user)


def _build_in_use_error(user: TheatreUser) -> TheatreInUse:
    return TheatreInUse(user.seen, action=user.advice("start again"))


def _identify_user(path: Path, file: int) -> TheatreUser:
    """Return the program that holds a lock, with its run if that program also wrote the note."""
    note, holder = read_note(path), find_lock_holder(file)
    return TheatreUser(note.run if holder is not None and holder.pid == note.pid else None, holder)


def _find_user_of_own_run(theatre: Path) -> TheatreUser | None:
    """Return the user of a simulated theatre that lies inside a run's folder, or None."""
    run = theatre.resolve().parent.parent
    if not (run / JOURNAL_FILE).is_file():
        return None
    holder = find_folder_holder(run)
    return None if holder is None else TheatreUser(run, holder)


def _count_journal_lines(run: Path) -> int:
    """Return the number of lines of a run's journal; 0 if it cannot be read."""
    try:
        return len(read_chain(run / JOURNAL_FILE).lines)
    except (OSError, RonnaError):
        return 0
