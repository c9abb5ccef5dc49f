"""Another run on the same theatre that left the arm away from home.

A new run would take that position for its home; a resumed one would send the arm home by a way of its own.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from procedures.cli.case.request_file import read_request
from procedures.engine.theatre_lock import is_there
from procedures.journal.journal import JOURNAL_FILE
from procedures.workcell.arm_history import arm_history
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain


def left_away(last: Path | None, run: Path | None) -> str | None:
    """What the operator of `run`, or of a new one, must know of the `last` one that moved this theatre's arm.

    None if it brought the arm home, is that run itself, or nothing is known of one.
    """
    if last is None or (run is not None and last.resolve() == run.resolve()):
        return None
    try:
        chain = read_chain(last / JOURNAL_FILE)
        away = arm_history(chain.lines).left_home
        if not (away or chain.torn):
            return None
    except (RonnaError, OSError):
        unread = f"run {last.name} moved the arm last, and its journal cannot be read"
        return unread if is_there(last) else None
    verb = "left" if away else "has lost the end of its journal, and may have left"
    left = f"run {last.name} {verb} the arm away from its home"
    try:
        read_request(last)
    except (RonnaError, OSError):  # of a check or a measurement, which nothing resumes
        return f"{left}; jog it home with the controller's pendant"
    return f"{left}; ronna-procedure home {shlex.quote(str(last))} brings it there"
