"""Who has the devices of a theatre file, and whether another run left their arm away from home."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from procedures.cli.case.left_away import left_away
from procedures.engine.theatre_lock import last_moved, theatre_user, unwritable_note
from ronna_hw.devices.probing import Diagnostic

RUN = "run"  # subject of a theatre that is in use


def use_diagnostics(theatre: Path) -> Iterator[Diagnostic]:
    """What of it keeps a new case from beginning; one with the subject `RUN` while it is in use."""
    if (user := theatre_user(theatre)) is not None:
        seen = f"{user.seen}: its devices were not checked"
        yield Diagnostic(RUN, False, seen, user.advice("check again"))
        return
    if (away := left_away(last_moved(theatre), None)) is not None:
        ask = "A new case asks whether to take where the arm stands as its home."
        yield Diagnostic("home of the arm", False, away, ask)
    if (note := unwritable_note(theatre)) is not None:
        advice = "Give this user the right to write it: it tells a later run what this one left."
        yield Diagnostic("note of the last run", False, f"{note} cannot be written", advice)
