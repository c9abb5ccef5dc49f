"""Running or resuming a case to its end, and its outcome from the records and any ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, theatre_time_s
from procedures.runs.case import clinical_input, restore_order
from procedures.runs.fault_script import list_unreached_faults
from procedures.runs.finishing import as_run_error
from procedures.runs.lifecycle import run_steps
from procedures.runs.observers import RunObservers
from procedures.runs.request import RunRequest
from procedures.runs.simulated_theatre import ask_verifier
from ronna_hw.command_line.messages import tell
from ronna_hw.evidence.journal_reading import read_chain

if TYPE_CHECKING:
    from procedures.engine.case import Case, Stored
    from procedures.reporting.outcome import FinishedOutcome, FinishedRun, Truth, UnfinishedRun
    from procedures.runs.interrupted_run import InterruptedRun, Resumption


def run_case(
    request: RunRequest, folder: Path, observers: RunObservers, resumption: Resumption | None = None
) -> FinishedRun:
    """Run a case, or the rest of an interrupted one, without writing its report.

    Raises the errors of steps, PRO-032 if it is not resumed, PRO-013 from the verifier.
    """
    engine, theatre_s = run_steps(request, folder, observers, resumption)
    if request.faults is not None and resumption is None:
        begun = (str(line["step"]) for line in read_chain(folder / JOURNAL_FILE).lines if "step" in line)
        for one in list_unreached_faults(request.faults, begun, theatre_s):
            tell(one)
    wall_s = wall_time_s(read_chain(folder / JOURNAL_FILE).lines)
    return build_finished_outcome(request, engine.case, engine.order.trajectories, theatre_s, wall_s)


def finish_case(
    request: RunRequest, interrupted: InterruptedRun, observers: RunObservers, *, accepted: bool
) -> FinishedRun:
    """Finish an interrupted case, opening a theatre only if there is work left."""
    from procedures.runs.interrupted_run import Resumption
    from procedures.runs.reopening import close_completed_run

    folder = interrupted.folder
    if is_all_done(request, interrupted):
        closed = close_completed_run(interrupted, clinical_input(request.case, folder))
        return outcome_as_recorded(request, closed)
    return run_case(request, folder, observers, Resumption(interrupted, accepted))


def is_all_done(request: RunRequest, interrupted: InterruptedRun) -> bool:
    """Whether an interrupted case has every step done and its arms at home, and was only not closed."""
    from procedures.engine.case_progress import CaseProgress

    if interrupted.untouched:
        return False
    order = restore_order(request.case, interrupted)
    return CaseProgress(order, interrupted.restore_case(order)).over and not interrupted.is_any_arm_out


def outcome_as_recorded(request: RunRequest, interrupted: InterruptedRun) -> FinishedRun:
    """Return the outcome of a finished case as recorded in its folder, with its report if any."""
    from procedures.reporting.kept_truth import load_sealed_truth

    folder, journal = interrupted.folder, interrupted.run.journal
    order = restore_order(request.case, interrupted)
    outcome = build_finished_outcome(
        request,
        interrupted.restore_case(order),
        order.trajectories,
        theatre_time_s(journal[-1]),
        wall_time_s(journal),
        load_sealed_truth(folder),
    )
    return with_report(outcome, folder)


def with_report(outcome: FinishedRun, folder: Path) -> FinishedRun:
    """Return the outcome with the path of the run's report, if there is one."""
    from ronna_hw.evidence.manifest import REPORT_FILE

    report = folder / REPORT_FILE
    return outcome.model_copy(update={"report": str(report) if report.exists() else None})


def wall_time_s(journal: Sequence[Line]) -> float:
    """Sum the host time in seconds over all processes of a run, from the dates in its journal."""
    total_s, began, last = 0.0, None, None
    for line in journal:
        if line["entry"] == Entry.RESTARTED and began is not None and last is not None:
            total_s += (last - began).total_seconds()
            began = None
        last = datetime.fromisoformat(str(line["host_time"]))
        began = began or last
    return total_s + ((last - began).total_seconds() if began is not None and last is not None else 0.0)


def build_unfinished_outcome(request: RunRequest, folder: Path, problem: BaseException) -> UnfinishedRun:
    """Return the outcome of a run that ended with `problem`."""
    from procedures.reporting.outcome import UnfinishedRun

    return UnfinishedRun(
        run=folder.name,
        outcome="interrupted" if isinstance(problem, KeyboardInterrupt) else "failed",
        seed=request.seed,
        strategy=request.case.strategy,
        localizer=request.case.methods.localizer,
        matcher=request.case.methods.matcher,
        error=as_run_error(problem),
    )


def build_finished_outcome(
    request: RunRequest,
    case: Case,
    trajectories: Sequence[str],
    theatre_time_s: float,
    wall_s: float,
    truth: Truth | None = None,
) -> FinishedRun:
    """Return the outcome of a finished case, asking the verifier for missing `truth`. Raises PRO-013."""
    from procedures.engine.run_folder import targets_in_doubt
    from procedures.operator.margin import MarginVerdict
    from procedures.reporting.ending import ending_of
    from procedures.reporting.kept_truth import store_truth
    from procedures.reporting.outcome import FinishedRun, RegistrationOutcome, TargetOutcome, Truth
    from procedures.reporting.run_reading import read_for_report, registrations_of
    from procedures.reporting.tables import target_rows
    from procedures.steps.clinical.intraoperative_scan import used_spheres
    from procedures.steps.clinical.plan_check import CheckedPlan
    from procedures.steps.clinical.results import ConfirmedTarget
    from procedures.steps.clinical.retreat import Retreated
    from procedures.steps.clinical.tool_change import MountedGuide

    if truth is None:
        truth = ask_verifier(case.folder) if request.config is None else Truth()
        store_truth(case.folder, truth)
    left_out = {one.trajectory: one.reason for one in case.left_out}
    names = [name for name in trajectories if name not in left_out]
    used = registrations_of(case)
    registered = {name: next(one.result for one in used if name in one.targets) for name in names}
    # There is no tool change after a move that came when every target was finished.
    streams: list[Stored[Any] | None] = [case.find(MountedGuide, None)]
    ends = (Retreated, ConfirmedTarget)
    streams += [case.find(model, name) for model in ends for name in names]
    links = [
        link
        for one in streams
        if one is not None
        for link in (one.result.link, one.result.assistant_link)
        if link is not None
    ]
    plan = case.get(CheckedPlan).result
    reading = read_for_report(case.folder, every_file=False).sealed_with(truth)
    rows = {row.target: row for row in target_rows(reading, truth)}
    errors_mm = [one.application_error_mm for one in truth.targets]
    beyond_margin_mm = {
        row.target: row.known_mm
        for row in rows.values()
        if row.verdict is MarginVerdict.BEYOND and row.known_mm is not None
    }
    limit_beyond_mm = {
        row.target: row.predicted.limit_mm
        for row in rows.values()
        if row.margin_mm is not None and row.predicted.limit_mm > row.margin_mm
    }
    in_doubt = targets_in_doubt(reading.run.journal)
    return FinishedRun(
        run=case.folder.name,
        outcome=cast("FinishedOutcome", ending_of(reading).word),
        seed=request.seed,
        strategy=request.case.strategy,
        localizer=request.case.methods.localizer,
        matcher=request.case.methods.matcher,
        markers=len(used_spheres(case).shown),
        ct=truth.ct,
        registration=RegistrationOutcome(
            n=registered[names[0]].pairs, fre_mm=tuple(one.fre_mm for one in registered.values())
        ),
        targets=tuple(
            TargetOutcome(
                id=name,
                depth_mm=plan.trajectory(name).depth_mm,
                strategy=rows[name].strategy,
                predicted_tre_mm=rows[name].predicted.rms_mm,
                application_error_mm=rows[name].error_mm,
                measured_error_mm=rows[name].measured_mm,
            )
            for name in names
        ),
        left_out=left_out,
        beyond_margin=beyond_margin_mm,
        limit_beyond_margin=limit_beyond_mm,
        in_doubt=in_doubt,
        mean_application_error_mm=sum(errors_mm) / len(errors_mm) if errors_mm else None,
        max_application_error_mm=max(errors_mm, default=None),
        late_cycles=sum(link.late_cycles + link.lost_cycles for link in links),
        sim_s=round(theatre_time_s, 3),
        wall_s=round(wall_s, 3),
    )
