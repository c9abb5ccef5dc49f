"""An earlier run on the same theatre that left the arm away from home: a new case would park it there."""

from __future__ import annotations

import shlex
from pathlib import Path

from procedures.cli.case.request import CaseRequest
from procedures.cli.case.request_file import read_request
from procedures.journal.journal import JOURNAL_FILE
from procedures.workcell.arm_as_left import arm_as_left
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain


def left_away(request: CaseRequest, folder: Path) -> str | None:
    """What the operator must know of the newest other run beside `folder` with the same theatre file.

    None if it brought the arm home, there is none, or the theatre is simulated for this run alone.
    """
    if request.config is None:
        return None
    for other in sorted(folder.parent.iterdir(), reverse=True):
        if other.name >= folder.name or other.name.startswith("."):
            continue
        try:
            config = read_request(other).config
            if config is None or config.resolve() != request.config.resolve():
                continue
            away = arm_as_left(read_chain(other / JOURNAL_FILE).lines).away
        except (RonnaError, OSError):  # no run, or one that cannot be read
            continue
        home = f"ronna-procedure home {shlex.quote(str(other.resolve()))}"
        return f"run {other.name} left the arm away from its home; {home} brings it there" if away else None
    return None
