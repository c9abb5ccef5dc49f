"""`ronna-procedure home RUN`: brings the arm of a run that has ended home, and does nothing else of it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from procedures.cli.case.display import following
from procedures.cli.case.leaving_report import leaving_report
from procedures.cli.case.left_away import left_away
from procedures.cli.case.request import CalibrationRun, CaseRequest
from procedures.cli.runs.left_runs import (
    held_left_run,
    make_ready,
    opened_left,
    request_of,
    require_free_devices,
)
from procedures.composition.procedure import Resumption
from procedures.engine.errors import RecoveryRefused
from procedures.engine.left_run import LeftRun
from procedures.engine.theatre_lock import last_moved
from procedures.journal.journal import Entry
from ronna_hw.command_line.terminal import print_json, say


def home(folder: Path, *, accept: bool, answers: Path | None, as_json: bool) -> None:
    """An instrument out along its axis, then the arm home, once what was found is accepted.

    Raises as `resume`; the run is unchanged and can be resumed.
    """
    request = request_of(folder, accept=accept, answers=answers)
    with held_left_run(folder, only_leaving=True) as left:
        if (nothing := _nothing_to_do(left)) is not None:
            _require_not_left_by_another(left, request)
            _say(left, nothing, home=left.parked or None, moved=False, as_json=as_json)
            return
        require_free_devices(request)
        make_ready(left)
        with leaving_report(left.run.path), following(quiet=as_json) as watcher:
            from procedures.recovery import bring_home

            with opened_left(
                request, left.run.path, watcher, Resumption(left, accept, only_leaving=True)
            ) as engine:
                moved = bring_home(engine, left)
        _say(left, "the arm is home" if moved else "the arm was already home", moved=moved, as_json=as_json)


def _nothing_to_do(left: LeftRun) -> str | None:
    """Why no device need be asked; None when one must."""
    if left.parked:
        return "the run is finished: its arm is parked"
    if not left.run.lines(Entry.MOTION) and not left.chain.torn:
        return "the run has moved nothing"
    return None


def _require_not_left_by_another(left: LeftRun, request: CaseRequest | CalibrationRun) -> None:
    """Raise PRO-032 with the run whose `home` brings the arm there, PRO-043 while that one still runs."""
    theatre = request.config
    if theatre is not None and (away := left_away(last_moved(theatre), left.run.path)) is not None:
        require_free_devices(request)
        raise RecoveryRefused(away, action="Nothing was moved.")


def _say(left: LeftRun, words: str, *, moved: bool, as_json: bool, home: Literal[True] | None = True) -> None:
    """`home` is None where no arm was asked."""
    if as_json:
        print_json({"run": left.run.path.name, "home": home, "moved": moved})
    else:
        say(words)
