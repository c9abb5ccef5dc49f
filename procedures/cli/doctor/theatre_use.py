"""Who has the devices of a theatre file, and whether another run left their arm away from home."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from procedures.runs.reopening import resumable_run
from procedures.runs.theatre_lock import last_moved, theatre_user, unwritable_note
from procedures.runs.theatre_note import arm_not_home, instrument_not_out
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.devices.readiness import MESSAGES

RUN = "run"  # subject of a theatre that is in use
INSTRUMENT = "instrument"  # subject of one that a run left in the head; shown before everything else
TOOL = "mounted tool"


def use_diagnostics(theatre: Path) -> Iterator[Diagnostic]:
    """What of it keeps a new case from beginning; one with the subject `RUN` while it is in use."""
    if (user := theatre_user(theatre)) is not None:
        seen = f"{user.seen}: its devices were not checked"
        yield Diagnostic(RUN, False, seen, user.advice("check again"))
        return
    last = last_moved(theatre)
    if (left := instrument_not_out(last)) is not None:
        run, inside = left
        advice = (
            "Touch neither the tool nor the arm, and start no other run: "
            f"ronna-procedure home {shlex.quote(str(run))} asks for the removal, then brings the arm home."
        )
        seen = f"run {run.name} is unfinished: {inside}"
        yield Diagnostic(INSTRUMENT, False, seen, advice)
    if (away := arm_not_home(last, None)) is not None:
        ask = "" if left else "A new case asks whether to take where the arm stands as its home."
        yield Diagnostic("home of the arm", False, away, ask)
    if (note := unwritable_note(theatre)) is not None:
        advice = "Give this user the right to write it: it tells a later run what this one left."
        yield Diagnostic("note of the last run", False, f"{note} cannot be written", advice)


def as_left(theatre: Path, found: Sequence[Diagnostic]) -> list[Diagnostic]:
    """What was found at the devices, with advice that fits what an unfinished run left there."""
    run, left = resumable_run(theatre), instrument_not_out(last_moved(theatre))
    return [_advised(one, run, None if left is None else left[1]) for one in found]


def _advised(one: Diagnostic, run: Path | None, inside: str | None) -> Diagnostic:
    if one.well:
        return one
    if inside is not None and one.subject.endswith(f": {TOOL}"):
        return replace(one, advice=f"Do not touch the tool: {inside}.")
    if run is not None and one.subject.endswith(f": {MESSAGES}"):
        name = f"ronna-procedure acknowledge {shlex.quote(str(run))} --by 'YOUR NAME'"
        return replace(one, advice=f"Remove its cause; then {name}.")
    return one
