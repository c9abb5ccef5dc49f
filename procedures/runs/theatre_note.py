"""Notes on an arm: which run has its devices, and where the last run left the arm.

The address of the arm's controller selects the note: a copy of the theatre file, or one with other records,
is the same arm. A simulated theatre has an identity instead, as another one may get its address next.
"""

from __future__ import annotations

import os
import shlex
import stat
from pathlib import Path

from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError

from procedures.journal.journal import JOURNAL_FILE
from procedures.runs.request_file import read_request
from procedures.workcell.arm_history import ArmPlace, arm_history, fold_history
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.config import MASTER, read_theatre_file
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.theatre_kind import is_on_this_computer

ARMS_FOLDER = Path("/var/tmp/ronna-hw")  # outlasts a restart of the computer, and every user may write there
NOT_KNOWN = (
    "the note about the last run on this arm cannot be read, or accounts that do not use the arm may have "
    "written it: that run may have left the arm away from its home"
)
JOG = "jog it home with the controller's pendant"


class TheatreNote(BaseModel):
    """Contents of an arm's note."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    run: Path | None = None  # the last that had the devices
    pid: int | None = None  # of its program, until it has written how it left the arm
    lines_before: NonNegativeInt = 0  # of its journal: what it moved before it had the devices does not count
    moved_before: Path | None = None  # the last run that moved the arm, `run` included once `pid` is gone
    at_home: bool = False  # that is where it left it
    unreadable: bool = False  # a note before was, and no run has moved the arm since

    def with_outcome(self) -> TheatreNote:
        """Return the note updated from the journal of `run`; the arm of a missing run may be anywhere."""
        home = (
            None
            if self.pid is None or self.run is None
            else _has_brought_arm_home(self.run, self.lines_before)
        )
        if home is None:
            return self.model_copy(update={"pid": None})
        return TheatreNote(run=self.run, moved_before=self.run, at_home=home)


def _has_brought_arm_home(run: Path, lines_before: int) -> bool | None:
    """Whether a run brought the arm home, or None if it certainly did not move the arm.

    Motions that were refused at home, or stopped there before they began, moved nothing.
    """
    try:
        if run.is_dir() and not (run / JOURNAL_FILE).exists():
            return None
        chain = read_chain(run / JOURNAL_FILE)
        arm = fold_history(chain)
        if not chain.torn and arm.journeys == arm_history(chain.lines[:lines_before]).journeys:
            return None
        return not arm.place.is_out
    except (OSError, RonnaError):
        return False


def note_path(theatre: Path) -> Path:
    """Return the path of an arm's note, beside the theatre file if the arm has no key."""
    theatre = theatre.resolve()
    if controller := _controller_key(theatre):
        return ARMS_FOLDER / f"{controller}.in-use"
    return theatre.with_name(f".{theatre.name}.in-use")


def _controller_key(theatre: Path) -> str:
    """Return a key for the arm: its addresses, a simulated theatre's identity, or empty if unknown."""
    try:
        file = read_theatre_file(theatre)
    except RonnaError:  # nothing runs with it
        return ""
    arm = file.robot.get(MASTER)
    if arm is None:
        return ""
    texts = (*arm.endpoints.values(), *([arm.endpoint] if arm.endpoint else []))
    peers = [parse_endpoint(text).resolve_names() for text in texts]
    if any(map(is_on_this_computer, peers)):
        return file.identity
    # At a UDP endpoint this computer listens: it says nothing about who sends there.
    return "+".join(sorted({(at.host or at.path).replace("/", "_") for at in peers if at.scheme != "udp"}))


def read_note(path: Path) -> TheatreNote:
    """Read a note; a missing file is an empty note.

    A note is not believed if it is damaged, or if an account that does not use the arm may have written it.
    """
    try:
        if not _is_trusted(path):
            return TheatreNote(unreadable=True)
        content = read_json_bytes(path)
        return TheatreNote.model_validate_json(content) if content else TheatreNote()
    except FileNotFoundError:
        return TheatreNote()
    except (OSError, RonnaError, ValidationError):
        return TheatreNote(unreadable=True)


def _is_trusted(note: Path) -> bool:
    """Whether only users of the arm can have written or removed the note. Raises OSError if it is missing.

    Next to a theatre file, its owner decides: not every file system has rights.
    """
    if note.parent != ARMS_FOLDER:
        return _is_ours(note.lstat())
    try:
        found = note.lstat()
    except FileNotFoundError:
        if not _is_ours(note.parent.lstat()):
            return False  # its owner can have removed it
        raise
    return _is_ours(found) and not found.st_mode & stat.S_IWOTH


def _is_ours(found: os.stat_result) -> bool:
    """Whether a file belongs to this user or root, or is writable by one of this user's groups."""
    by_group = bool(found.st_mode & stat.S_IWGRP) and found.st_gid in (os.getegid(), *os.getgroups())
    return found.st_uid in (os.geteuid(), 0) or by_group


def run_exists(run: Path) -> bool:
    """Whether the folder of a run exists, or may exist where this user cannot see it."""
    try:
        return run.exists()
    except OSError:
        return True


def arm_not_home(note: TheatreNote, run: Path | None) -> str | None:
    """Return a warning for the operator of `run` if another run left this theatre's arm away from home.

    None if the last run brought it home, is `run` itself, or does not exist. A new run would take the arm's
    position for its home; a resumed one would send the arm home by a way of its own.
    """
    if note.unreadable:
        return NOT_KNOWN
    last = note.moved_before
    if last is None or (run is not None and _is_same(last, run)):
        return None
    try:
        chain = read_chain(last / JOURNAL_FILE)
        place = fold_history(chain).place
        if not place.is_out:
            return None
    except (RonnaError, OSError):
        if run_exists(last):
            return f"run {last.name} moved the arm last, and its journal cannot be read"
        gone = f"run {last.name} moved the arm last, and its folder {last} is gone"
        return None if note.at_home else f"{gone}; put it back for ronna-procedure home, or {JOG}"
    verb = "has lost the end of its journal, and may have left" if chain.torn else "left"
    message = f"run {last.name} {verb} the arm away from its home"
    try:
        read_request(last)
    except (RonnaError, OSError):  # of a check or a measurement, which nothing resumes
        return f"{message}; {JOG}"
    return f"{message}; ronna-procedure home {shlex.quote(str(last))} brings it there"


def describe_arm_without_record(place: ArmPlace, *, own: bool) -> str:
    """Describe where the arm of a deleted run is and how it comes home; `own` is the run's own simulation."""
    if not place.is_out:
        return "the arm is at home" if place.is_home else "the arm was not moved"
    where, first = "away from its home", ""
    if place.trajectory is not None:
        where, first = f"on the axis of {place.trajectory}", "withdraw the guide along the axis, then "
    if own:
        return f"the arm is {where}; its simulated theatre ends with this run, nothing has to be brought home"
    return f"the arm is {where}, and no command brings it home without the record: {first}{JOG}"


def find_instrument_inside(note: TheatreNote) -> tuple[Path, str] | None:
    """Return the last run that moved the arm and where its instrument may still be, or None."""
    last = note.moved_before
    if last is None:
        return None
    try:
        inside = fold_history(read_chain(last / JOURNAL_FILE)).place.instrument_description
    except (RonnaError, OSError):  # `arm_not_home` says that nothing is known of it
        return None
    return None if inside is None else (last, inside)


def _is_same(last: Path, run: Path) -> bool:
    """Whether two folders are the same run according to the journal, even if it was renamed."""
    if last.resolve() == run.resolve():
        return True
    try:
        first, *_ = read_chain(run / JOURNAL_FILE).lines or ({},)
    except (RonnaError, OSError):
        return False
    return not run_exists(last) and first.get("run") == last.name
