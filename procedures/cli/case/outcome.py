"""Runs a case to its end and reports the outcome: from its records, and from the truth where there is one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.fault_script import never_began
from procedures.cli.case.leaving_report import error_of
from procedures.cli.case.opening import Watcher, opened_case
from procedures.cli.case.prompt import leave_head_if_agreed
from procedures.cli.case.request import CaseRequest
from procedures.cli.case.truth import truth_of
from procedures.composition.procedure import Resumption
from procedures.engine.run_folder import targets_in_doubt
from procedures.journal.journal import JOURNAL_FILE, Entry, Line
from procedures.operator.errors import OperatorAborted
from procedures.results.errors import StepRefused
from ronna_hw.command_line.messages import tell
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain

if TYPE_CHECKING:
    from procedures.engine.case import Case
    from procedures.engine.engine import Engine
    from procedures.reporting.outcome import FinishedRun, Truth, UnfinishedRun


def run_case(
    request: CaseRequest, folder: Path, watcher: Watcher, resumption: Resumption | None = None
) -> FinishedRun:
    """Run a whole case, or what remains of it, without its report.

    Raises what a step raises, PRO-032 where it is not taken up again, PRO-013 from the verifier.
    """
    began_s = time.monotonic()
    with opened_case(request, folder, watcher, resumption) as engine:
        if resumption is not None and not resumption.left.untouched:
            from procedures.recovery import recover

            if watcher.pilot is not None:
                watcher.pilot.await_operator()
            recover(engine, resumption.left)
        _run(engine, watcher)
        theatre_time_s = engine.setting.clock.now_s()  # the clock ends with its theatre
    if request.faults is not None and resumption is None:
        begun = (str(line["step"]) for line in read_chain(folder / JOURNAL_FILE).lines if "step" in line)
        for one in never_began(request.faults, begun, theatre_time_s):
            tell(one)
    before_s = 0.0 if resumption is None else wall_time_s(resumption.left.run.journal)
    wall_s = before_s + time.monotonic() - began_s
    return finished(request, engine.case, engine.order.trajectories, theatre_time_s, wall_s)


def wall_time_s(journal: Sequence[Line]) -> float:
    """Host time that the programs of a run took, by the dates of its journal."""
    total_s, began, last = 0.0, None, None
    for line in journal:
        if line["entry"] == Entry.RESTARTED and began is not None and last is not None:
            total_s += (last - began).total_seconds()
            began = None
        last = datetime.fromisoformat(str(line["host_time"]))
        began = began or last
    return total_s + ((last - began).total_seconds() if began is not None and last is not None else 0.0)


def _run(engine: Engine, watcher: Watcher) -> None:
    """Run to the end; a step that fails is put before the person at the terminal, if there is one.

    Who leaves a case that is refused only because a device is still in fault leaves it with that fault.
    """
    held = watcher.held
    failure: RonnaError | None = None
    acknowledged = 0  # before it
    run = engine.run_to if watcher.pilot is None else partial(watcher.pilot.run_to_end, engine)
    while True:
        try:
            run()
            if engine.course.over and not engine.over:  # a case has not ended while its arm is out
                engine.retreat_home()
            return
        except OperatorAborted:
            led_home = watcher.pilot is not None and watcher.pilot.has_led_home
            if held is not None and not led_home:
                leave_head_if_agreed(engine)
            raise
        except RonnaError as error:
            if held is None or engine.machine.ended:
                raise
            held.tell_held(engine, error)
            if failure is None or not isinstance(error, StepRefused) or not engine.faults.now:
                failure, acknowledged = error, engine.faults.acknowledgements
            if not held.follow(engine):
                failure.shown = True
                raise engine.faults.as_of_now(failure, acknowledged) from None


def unfinished(request: CaseRequest, folder: Path, problem: BaseException) -> UnfinishedRun:
    """A run that `problem` ended."""
    from procedures.reporting.outcome import UnfinishedRun

    return UnfinishedRun(
        run=folder.name,
        outcome="interrupted" if isinstance(problem, KeyboardInterrupt) else "failed",
        seed=request.seed,
        strategy=request.strategy,
        error=error_of(problem),
    )


def finished(
    request: CaseRequest,
    case: Case,
    trajectories: Sequence[str],
    theatre_time_s: float,
    wall_s: float,
    truth: Truth | None = None,
) -> FinishedRun:
    """What a finished case came to, by `truth` where that is kept; raises PRO-013 from the verifier."""
    from procedures.reporting.files import store_truth
    from procedures.reporting.outcome import Truth

    if truth is None:
        truth = truth_of(case.folder) if request.config is None else Truth()
        store_truth(case.folder, truth)
    return _outcome(request, case, trajectories, truth, theatre_time_s, wall_s)


def _outcome(
    request: CaseRequest,
    case: Case,
    trajectories: Sequence[str],
    truth: Truth,
    theatre_time_s: float,
    wall_s: float,
) -> FinishedRun:
    from procedures.reporting.outcome import FinishedRun, RegistrationOutcome, TargetOutcome
    from procedures.reporting.run_reading import registrations_of
    from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
    from procedures.steps.clinical.plan_check import CheckedPlan
    from procedures.steps.clinical.results import ConfirmedTarget
    from procedures.steps.clinical.retreat import Retreated
    from procedures.steps.clinical.tool_change import MountedGuide

    left_out = {one.trajectory: one.reason for one in case.left_out}
    names = [name for name in trajectories if name not in left_out]
    used = registrations_of(case)
    registered = {name: next(one.result for one in used if name in one.targets) for name in names}
    changed = case.find(MountedGuide, None)  # none after a move that came when every target was finished
    links = [
        *(() if changed is None else (changed.result.link,)),
        *(one.result.link for name in names if (one := case.find(Retreated, name)) is not None),
        *(
            look.result.link
            for name in names
            if (look := case.find(ConfirmedTarget, name)) and look.result.link
        ),
    ]
    depth_mm = {one.id: one.depth_mm for one in case.get(CheckedPlan).result.plan.trajectories}
    measured_mm = {name: _measured_error_mm(case, name) for name in names}
    errors_mm = {one.id: one.application_error_mm for one in truth.targets}
    in_doubt = targets_in_doubt(read_chain(case.folder / JOURNAL_FILE).lines)
    return FinishedRun(
        run=case.folder.name,
        outcome="in doubt" if in_doubt else "done",
        seed=request.seed,
        strategy=request.strategy,
        markers=len(case.get(LocalizedFiducials).result.markers),
        ct=truth.ct,
        registration=RegistrationOutcome(
            n=registered[names[0]].pairs, fre_mm=tuple(one.fre_mm for one in registered.values())
        ),
        targets=tuple(
            TargetOutcome(
                id=name,
                depth_mm=depth_mm[name],
                predicted_tre_mm=registered[name].prediction(name).rms_mm,
                application_error_mm=errors_mm.get(name),
                measured_error_mm=measured_mm.get(name),
            )
            for name in names
        ),
        left_out=left_out,
        in_doubt=in_doubt,
        mean_application_error_mm=sum(errors_mm.values()) / len(errors_mm) if errors_mm else None,
        max_application_error_mm=max(errors_mm.values(), default=None),
        late_cycles=sum(link.late_cycles + link.lost_cycles for link in links),
        sim_s=round(theatre_time_s, 3),
        wall_s=round(wall_s, 3),
    )


def _measured_error_mm(case: Case, trajectory: str) -> float | None:
    from procedures.steps.clinical.target_measurement import MeasuredTarget

    measured = case.find(MeasuredTarget, trajectory)
    return None if measured is None else measured.result.error_mm
