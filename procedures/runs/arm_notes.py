"""Notes on an arm: which run has its devices, and where the last run left the arm.

The address of the arm's controller selects the note: a copy of the theatre file, or one with other records,
is the same arm. A simulated theatre has an identity instead, as another one may get its address next.
"""

from __future__ import annotations

import os
import shlex
import stat
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, NonNegativeInt, ValidationError

from procedures.engine.errors import InstrumentLeftInside
from procedures.journal.journal import JOURNAL_FILE
from procedures.runs.request_file import read_request
from procedures.workcell.arm_history import ArmPlace, arm_history, describe_instrument, fold_arms
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.config import read_theatre_file
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JournalChain, Line, read_chain
from ronna_hw.evidence.lost_journal_end import find_lost_lines, read_events
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.theatre_kind import is_on_this_computer

ROLES = (MASTER, ASSISTANT)
ARMS_FOLDER = Path("/var/tmp/ronna-hw")  # outlasts a restart of the computer, and every user may write there
NOT_KNOWN = (
    "the note about the last run on this arm cannot be read, or accounts that do not use the arm may have "
    "written it: that run may have left the arm away from its home"
)
JOG = "jog it home with the controller's pendant"


class TheatreNote(BaseModel, frozen=True, extra="forbid"):
    """Contents of an arm's note."""

    run: Path | None = None  # the last that had the devices
    pid: int | None = None  # of its program, until it has written how it left the arm
    lines_before: NonNegativeInt = 0  # of its journal: what it moved before it had the devices does not count
    moved_before: Path | None = None  # the last run that moved the arm, `run` included once `pid` is gone
    at_home: bool = False  # that is where it left it
    unreadable: bool = False  # a note before was, and no run has moved the arm since
    role: str | None = None  # of this arm in `run`; None: the note is for all of its arms
    moved_role: str | None = None  # the same in `moved_before`

    def with_outcome(self) -> TheatreNote:
        """Return the note updated from the journal of `run`; the arm of a missing run may be anywhere."""
        home = (
            None
            if self.pid is None or self.run is None
            else _has_brought_arm_home(self.run, self.lines_before, self.role)
        )
        if home is None:
            return self.model_copy(update={"pid": None})
        return TheatreNote(
            run=self.run, moved_before=self.run, at_home=home, role=self.role, moved_role=self.role
        )


def _has_brought_arm_home(run: Path, lines_before: int, role: str | None) -> bool | None:
    """Whether a run brought the arm home with nothing inside, or None if it certainly did not move the arm.

    Motions that were refused at home, or stopped there before they began, moved nothing.
    """
    try:
        if run.is_dir() and not (run / JOURNAL_FILE).exists():
            return None
        chain, lost = _read_left_journal(run)
        arms = fold_arms(chain, lost)
        inside = describe_instrument(arms[0].place, arms[1].held)
        arms_noted = [arm for arm in arms if role in (None, arm.arm)]
        before = chain.lines[:lines_before]
        moved = any(arm.journeys != arm_history(before, arm.arm).journeys for arm in arms_noted)
        if not (chain.torn or lost or inside or moved):
            return None
        return not (inside or any(arm.place.is_out for arm in arms_noted))
    except (OSError, RonnaError):
        return False


def _read_left_journal(run: Path) -> tuple[JournalChain, tuple[Line, ...]]:
    """Read the journal of an ended program, and the lines at its end that only the event file still has."""
    events = read_events(run)
    chain = read_chain(run / JOURNAL_FILE)
    return chain, find_lost_lines(events, chain.lines)


def note_paths(theatre: Path, roles: Collection[str] = ROLES) -> dict[Path, str | None]:
    """Return the paths of the notes of a theatre's arms in these roles, with the role of each.

    One note is for all arms of a simulated theatre; one beside the theatre file, if no arm has a key.
    """
    theatre = theatre.resolve()
    noted = {
        ARMS_FOLDER / f"{controller}.in-use": role
        for role, controller in _controller_keys(theatre).items()
        if role is None or role in roles
    }
    return noted or {theatre.with_name(f".{theatre.name}.in-use"): None}


def _controller_keys(theatre: Path) -> dict[str | None, str]:
    """Return the keys of arms with known addresses, by role; for None that of a simulated theatre."""
    try:
        file = read_theatre_file(theatre)
    except RonnaError:  # nothing runs with it
        return {}
    keys: dict[str | None, str] = {}
    for role, arm in file.robot.items():
        texts = (*arm.endpoints.values(), *([arm.endpoint] if arm.endpoint else []))
        peers = [parse_endpoint(text).resolve_names() for text in texts]
        if any(map(is_on_this_computer, peers)):
            return {None: file.identity} if file.identity else {}
        # At a UDP endpoint this computer listens: it says nothing about who sends there.
        hosts = {(at.host or at.path).replace("/", "_") for at in peers if at.scheme != "udp"}
        if hosts:
            keys[role] = "+".join(sorted(hosts))
    return keys


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


def list_noted_theatres() -> Iterator[Path]:
    """Yield the theatre file of each arm's run whose program has not written how it left the arm."""
    for path in sorted(ARMS_FOLDER.glob("*.in-use")):
        note = read_note(path)
        if note.pid is None or note.run is None:
            continue
        with suppress(RonnaError, OSError):
            if (config := read_request(note.run).config) is not None:
                yield config


def run_exists(run: Path) -> bool:
    """Whether the folder of a run exists, or may exist where this user cannot see it."""
    try:
        return run.exists()
    except OSError:
        return True


@dataclass(frozen=True)
class FormerRun:
    """The arm as the run before left it: what a new run on it is refused for, warned of or asked about."""

    run: Path | None = None
    not_home: str | None = None  # it is or may be away from its home, and how it gets there
    inside: str | None = None  # an instrument is or may be inside
    home: str | None = None  # the command that brings it home, of a run that can be resumed

    @property
    def refusal(self) -> InstrumentLeftInside | None:
        """PRO-047 while an instrument may be inside and that run can ask for its removal, or None.

        If nothing resumes that run, `not_home` tells the operator of the instrument before anything moves.
        """
        if self.run is None or self.inside is None or self.home is None:
            return None
        return InstrumentLeftInside(
            f"run {self.run.name} on this theatre is unfinished: {self.inside}",
            action="Touch neither the tool nor the arm, and start no other run: "
            f"{self.home} asks for the removal, then brings the arm home.",
        )

    def require_no_instrument(self) -> None:
        """Raise PRO-047 as `refusal` says."""
        if (refusal := self.refusal) is not None:
            raise refusal


def find_former_run(note: TheatreNote, run: Path | None) -> FormerRun:
    """Return how another run than `run` left this theatre's arm; empty if at home with nothing inside.

    A new run would take the arm's position for its home; a resumed one would send the arm home by a way of
    its own.
    """
    if note.unreadable:
        return FormerRun(not_home=NOT_KNOWN)
    last = note.moved_before
    if last is None or (run is not None and _is_same(last, run)):
        return FormerRun()
    try:
        chain, lost_lines = _read_left_journal(last)
        master, assistant = fold_arms(chain, lost_lines)
        is_out = any(arm.place.is_out for arm in (master, assistant) if note.moved_role in (None, arm.arm))
    except (RonnaError, OSError):
        lost = _describe_lost_run(last, at_home=note.at_home)
        return FormerRun() if lost is None else FormerRun(last, lost)
    inside = describe_instrument(master.place, assistant.held)
    try:
        read_request(last)
        home = f"ronna-procedure home {shlex.quote(str(last))}"
    except (RonnaError, OSError):  # of a check or a measurement, which nothing resumes
        home = None
    if not (is_out or inside):
        return FormerRun()
    verb = "has lost the end of its journal, and may have left" if chain.torn or lost_lines else "left"
    message = f"run {last.name} {verb} the arm away from its home" if is_out else f"run {last.name} ended"
    if home is not None:
        return FormerRun(last, f"{message}; {home} brings it there" if is_out else None, inside, home)
    if inside is not None:
        message = f"{message}, and {inside}: take it out by hand"
    return FormerRun(last, f"{message}; {JOG}", inside)


def _describe_lost_run(last: Path, *, at_home: bool) -> str | None:
    """Describe a run whose journal cannot be read; None if it had brought the arm home before it went."""
    may_be_inside = "an instrument may still be inside"
    if run_exists(last):
        return f"run {last.name} moved the arm last, and its journal cannot be read: {may_be_inside}"
    if at_home:
        return None
    gone = f"run {last.name} moved the arm last, and its folder {last} is gone"
    return f"{gone}; put it back for ronna-procedure home, or {JOG}: {may_be_inside}"


def describe_arm_without_record(place: ArmPlace, *, own: bool) -> str:
    """Describe where the arm of a deleted run is and how it comes home; `own` is the run's own simulation."""
    inside = place.instrument_description
    if not (place.is_out or inside):
        return "the arm is at home" if place.is_home else "the arm was not moved"
    where, first = "away from its home" if place.is_out else "at home", ""
    if place.trajectory is not None:
        where, first = f"on the axis of {place.trajectory}", "withdraw the guide along the axis, then "
    if inside is not None:
        where, first = f"{where}, and {inside}", f"take it out by hand, {first or 'then '}"
    if own:
        return f"the arm is {where}; its simulated theatre ends with this run, nothing has to be brought home"
    return f"the arm is {where}, and no command brings it home without the record: {first}{JOG}"


def _is_same(last: Path, run: Path) -> bool:
    """Whether two folders are the same run according to the journal, even if it was renamed."""
    if last.resolve() == run.resolve():
        return True
    try:
        first, *_ = read_chain(run / JOURNAL_FILE).lines or ({},)
    except (RonnaError, OSError):
        return False
    return not run_exists(last) and first.get("run") == last.name
