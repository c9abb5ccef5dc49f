"""Another run on the same theatre that left the arm away from home.

A new run would take that position for its home; a resumed one would send the arm home by a way of its own.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from procedures.cli.case.request_file import read_request
from procedures.engine.theatre_note import NOT_KNOWN, TheatreNote, is_there
from procedures.journal.journal import JOURNAL_FILE
from procedures.workcell.arm_history import history_left_by
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain

JOG = "jog it home with the controller's pendant"


def left_away(note: TheatreNote, run: Path | None) -> str | None:
    """What the operator of `run`, or of a new one, must know of the last one that moved this theatre's arm.

    None if it brought the arm home, is that run itself, or there is none.
    """
    if note.unreadable:
        return NOT_KNOWN
    last = note.moved_before
    if last is None or (run is not None and _is_same(last, run)):
        return None
    try:
        chain = read_chain(last / JOURNAL_FILE)
        place = history_left_by(chain).place
        if not place.is_out:
            return None
    except (RonnaError, OSError):
        if is_there(last):
            return f"run {last.name} moved the arm last, and its journal cannot be read"
        gone = f"run {last.name} moved the arm last, and its folder {last} is gone"
        return None if note.at_home else f"{gone}; put it back for ronna-procedure home, or {JOG}"
    verb = "has lost the end of its journal, and may have left" if chain.torn else "left"
    left = f"run {last.name} {verb} the arm away from its home"
    try:
        read_request(last)
    except (RonnaError, OSError):  # of a check or a measurement, which nothing resumes
        return f"{left}; {JOG}"
    return f"{left}; ronna-procedure home {shlex.quote(str(last))} brings it there"


def instrument_left(note: TheatreNote) -> tuple[Path, str] | None:
    """The last run that moved this theatre's arm, and that an instrument is or may be in, where one is."""
    last = note.moved_before
    if last is None:
        return None
    try:
        inside = history_left_by(read_chain(last / JOURNAL_FILE)).place.instrument_in_words
    except (RonnaError, OSError):  # `left_away` says that nothing is known of it
        return None
    return None if inside is None else (last, inside)


def _is_same(last: Path, run: Path) -> bool:
    """Also under a new name, by its journal."""
    if last.resolve() == run.resolve():
        return True
    try:
        first, *_ = read_chain(run / JOURNAL_FILE).lines or ({},)
    except (RonnaError, OSError):
        return False
    return not is_there(last) and first.get("run") == last.name
