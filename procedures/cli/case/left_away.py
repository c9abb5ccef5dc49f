"""An earlier run on the same theatre that left the arm away from home: a new run would park it there."""

from __future__ import annotations

import shlex
from pathlib import Path

from procedures.cli.case.request_file import read_request
from procedures.journal.journal import JOURNAL_FILE
from procedures.workcell.arm_history import arm_history
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain


def left_away(last: Path | None) -> str | None:
    """What the operator must know of the last run that moved the arm of this theatre.

    None if it brought the arm home, or nothing is known of one.
    """
    if last is None:
        return None
    try:
        if not arm_history(read_chain(last / JOURNAL_FILE).lines).left_home:
            return None
    except (RonnaError, OSError):
        return (
            f"run {last.name} moved the arm last, and its journal cannot be read" if last.exists() else None
        )
    left = f"run {last.name} left the arm away from its home"
    try:
        read_request(last)
    except (RonnaError, OSError):  # of a check or a measurement, which nothing resumes
        return f"{left}; jog it home with the controller's pendant"
    return f"{left}; ronna-procedure home {shlex.quote(str(last))} brings it there"
