"""`ronna-procedure resume RUN` continues an interrupted run; `home RUN` only brings its arm home."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from procedures.cli.case.display import follow, following, show_outcome
from procedures.engine.errors import RecoveryRefused
from procedures.runs.case_outcome import finish_case, outcome_as_recorded, with_report
from procedures.runs.finishing import finalized_run, sealed_again
from procedures.runs.interrupted_run import InterruptedRun, Resumption
from procedures.runs.lifecycle import open_run
from procedures.runs.reopening import (
    held_interrupted_run,
    make_ready,
    reopened_request,
    require_free_devices,
)
from procedures.runs.request import CalibrationProcedure, RunRequest
from procedures.runs.theatre_lock import last_moved
from procedures.runs.theatre_note import arm_not_home
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.terminal import print_json, say, tell

if TYPE_CHECKING:
    from procedures.runs.console_link import ConsoleRequest


def resume(
    folder: Path,
    *,
    accept: bool,
    answers: Path | None,
    as_json: bool,
    console: ConsoleRequest | None = None,
) -> None:
    """Resume a run and finish it; a finished one is shown.

    With a console, nothing is read until someone is in its seat, unless a script accepts. Raises PRO-030 to
    PRO-034, PRO-043, PRO-003 if nothing can be written, and the errors of devices and steps.
    """
    request = reopened_request(folder, accept=accept, answers=answers, as_before=True)
    with held_interrupted_run(folder) as interrupted:
        if isinstance(request.procedure, CalibrationProcedure):
            if console is not None:
                raise UsageMistake(
                    "--console operates cases, and this is a calibration", action="Omit --console."
                )
            from procedures.cli.calibrating.calibration import resume_calibration

            resume_calibration(request, interrupted, accepted=accept, as_json=as_json)
        elif interrupted.finished:
            with sealed_again(interrupted) as closed:
                outcome = outcome_as_recorded(request, closed)
            tell(f"{interrupted.run.name} is finished: nothing remains to be done")
            show_outcome(with_report(outcome, interrupted.folder), as_json=as_json)
        else:
            require_free_devices(request)
            make_ready(interrupted)
            finish = partial(finish_case, request, interrupted, accepted=accept)
            follow(request, interrupted.folder, finish, console, as_json=as_json, waits=not accept)


def home(folder: Path, *, accept: bool, answers: Path | None, as_json: bool) -> None:
    """Have an instrument taken out, then bring the arm home, once the findings are accepted.

    Raises the errors of `resume`; the run is unchanged and can be resumed.
    """
    request = reopened_request(folder, accept=accept, answers=answers)
    with held_interrupted_run(folder, only_leaving=True) as interrupted:
        if (nothing := interrupted.nothing_to_bring_home) is not None:
            _require_not_left_by_another(interrupted, request)
            _say(interrupted, nothing, home=interrupted.parked or None, moved=False, as_json=as_json)
            return
        require_free_devices(request)
        make_ready(interrupted)
        with finalized_run(interrupted.folder), following(quiet=as_json) as observers:
            from procedures.runs.recovery import bring_home

            resumption = Resumption(interrupted, accept, only_leaving=True)
            with open_run(request, interrupted.folder, observers, resumption) as engine:
                moved = bring_home(engine, interrupted)
        words = "the arm is home" if moved else "the arm was already home"
        _say(interrupted, words, moved=moved, as_json=as_json)


def _require_not_left_by_another(interrupted: InterruptedRun, request: RunRequest) -> None:
    """Raise PRO-032 with the run whose `home` brings the arm there, PRO-043 while that one still runs."""
    theatre = request.config
    if theatre is not None and (away := arm_not_home(last_moved(theatre), interrupted.folder)) is not None:
        require_free_devices(request)
        raise RecoveryRefused(away, action="Nothing was moved.")


def _say(
    interrupted: InterruptedRun, words: str, *, moved: bool, as_json: bool, home: Literal[True] | None = True
) -> None:
    """Print the outcome; `home` is None if no arm was asked."""
    if as_json:
        print_json({"run": interrupted.folder.name, "home": home, "moved": moved})
    else:
        say(words)
