"""`ronna-procedure resume RUN`: continues a run that was killed, left or interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.case_inputs import clinical_input, order_of_case
from procedures.cli.case.display import follow, show_outcome
from procedures.cli.case.leaving_report import leave_report, seal_run
from procedures.cli.case.opening import Watcher
from procedures.cli.case.outcome import finished, run_case, wall_time_s
from procedures.cli.case.request import CalibrationRun, CaseRequest
from procedures.cli.runs.left_runs import (
    close_again,
    close_left,
    held_left_run,
    make_ready,
    request_of,
    require_free_devices,
)
from procedures.composition.procedure import Resumption
from procedures.engine.course import Course
from procedures.engine.left_run import LeftRun
from procedures.journal.journal import theatre_time_s
from procedures.reporting.files import load_truth
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.evidence.manifest import REPORT_FILE, is_sealed

if TYPE_CHECKING:
    from procedures.cli.console.attaching import ConsoleRequest
    from procedures.reporting.outcome import FinishedRun


def resume(
    folder: Path,
    *,
    accept: bool,
    answers: Path | None,
    as_json: bool,
    console: ConsoleRequest | None = None,
) -> None:
    """Take a run up again and finish it; a finished one is shown.

    With a console, nothing is read until someone is in its seat, unless a script accepts.

    Raises PRO-030 to PRO-034, PRO-043, PRO-003 where nothing can be written, and what devices and steps
    raise.
    """
    request = request_of(folder, accept=accept, answers=answers, as_before=True)
    with held_left_run(folder) as left:
        if isinstance(request, CalibrationRun):
            _resume_calibration(request, left, console, accepted=accept, as_json=as_json)
            return
        if left.finished:
            sealed = is_sealed(left.run.path)
            if not sealed:  # it was killed between its last line and its seal
                make_ready(left)
                left = close_again(left)
            outcome = _as_it_ended(request, left)
            if not sealed:
                leave_report(left.run.path, name_it=False)
                seal_run(left.run.path)
                outcome = _with_report(outcome, left.run.path)
            tell(f"{left.run.name} is finished: nothing remains to be done")
            show_outcome(outcome, as_json=as_json)
            return
        require_free_devices(request)
        make_ready(left)
        follow(
            request,
            left.run.path,
            lambda watcher: _operated(request, left, watcher, console, accepted=accept),
            as_json=as_json,
        )


def _resume_calibration(
    request: CalibrationRun, left: LeftRun, console: ConsoleRequest | None, *, accepted: bool, as_json: bool
) -> None:
    if console is not None:
        raise UsageMistake("--console operates cases, and this is a calibration", action="Omit --console.")
    from procedures.cli.calibrating.resuming import resume_calibration

    resume_calibration(request, left, accepted=accepted, as_json=as_json)


def _operated(
    request: CaseRequest, left: LeftRun, watcher: Watcher, console: ConsoleRequest | None, *, accepted: bool
) -> FinishedRun:
    if console is None:
        return _go_on(request, left, watcher, accepted=accepted)
    from procedures.cli.console.attaching import with_console

    with with_console(watcher, left.run.path, console, waits=not accepted) as operated:
        return _go_on(request, left, operated, accepted=accepted)


def _go_on(request: CaseRequest, left: LeftRun, watcher: Watcher, *, accepted: bool) -> FinishedRun:
    if not left.untouched and _nothing_remains(request, left):
        return _as_it_ended(request, close_left(left, clinical_input(request, left.run.path)))
    return run_case(request, left.run.path, watcher, Resumption(left, accepted))


def _nothing_remains(request: CaseRequest, left: LeftRun) -> bool:
    """Whether only the last line is missing: what ends a case that runs would have ended this one."""
    order = order_of_case(request, left.run.path)
    return Course(order, left.restored(order)).over and not left.arm.place.is_out


def _as_it_ended(request: CaseRequest, left: LeftRun) -> FinishedRun:
    folder, journal = left.run.path, left.run.journal
    order = order_of_case(request, folder)
    moment_s = theatre_time_s(journal[-1])
    outcome = finished(
        request,
        left.restored(order),
        order.trajectories,
        moment_s,
        wall_time_s(journal),
        load_truth(folder) if is_sealed(folder) else None,
    )
    return _with_report(outcome, folder)


def _with_report(outcome: FinishedRun, folder: Path) -> FinishedRun:
    report = folder / REPORT_FILE
    return outcome.model_copy(update={"report": str(report) if report.exists() else None})
