"""The CT, plan and steps of a clinical case, new or interrupted."""

from __future__ import annotations

import contextlib
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.runs.request import DEFAULT_ARM, CaseProcedure, RunRequest
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, read_bounded
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.engine.order import CaseOrder
    from procedures.engine.setting import ClinicalInput
    from procedures.planning.plan_lock import LockedPlan
    from procedures.planning.plan_model import Plan
    from procedures.runs.engine_setup import EngineInput
    from procedures.runs.interrupted_run import InterruptedRun, Resumption
    from procedures.strategies.strategy import Strategy
    from ronna_hw.theatre import Theatre


SIMULATED_CASE = "case"  # folder in a run with the simulated patient


def case_folder(case: CaseProcedure, folder: Path) -> Path:
    """Return the folder with the CT and plan of the run in `folder`."""
    return case.case or folder / SIMULATED_CASE


def clinical_input(case: CaseProcedure, folder: Path, plan: LockedPlan | None = None) -> ClinicalInput:
    """Return CT, plan, strategy and methods of a run, with the hash of the locked plan if given."""
    from procedures.engine.setting import ClinicalInput
    from procedures.planning.plan_file import parse_plan_bytes

    place = case_folder(case, folder)
    return ClinicalInput(
        place / "ct",
        place / "plan.toml",
        strategy_of(case, None if plan is None else parse_plan_bytes(plan.content, place.name)),
        case.measure_targets,
        None if plan is None else plan.sha256,
        case.methods,
        roles=case.roles,
        intraoperative=case.intraoperative,
    )


def restore_order(case: CaseProcedure, interrupted: InterruptedRun) -> CaseOrder:
    """Return the step order of an interrupted run from the plan it checked, even if the file has changed.

    Raises REC-001, REC-003.
    """
    from procedures.engine.case import results_of
    from procedures.steps.clinical.plan_check import CheckedPlan

    checked = results_of(CheckedPlan, interrupted.run.records)
    return _build_order(case, checked[-1].result.plan if checked else None)


def strategy_of(case: CaseProcedure, plan: Plan | None) -> Strategy:
    """Return the strategy of a case; without any sphere there is but one."""
    from procedures.planning.plan_model import FiducialKind
    from procedures.strategies.catalogue import find_strategy
    from procedures.strategies.skin_looks import SkinLooks

    without_spheres = plan is not None and plan.fiducials is FiducialKind.SURFACE
    return SkinLooks() if without_spheres else find_strategy(case.strategy)


def _build_order(case: CaseProcedure, plan: Plan | None) -> CaseOrder:
    from procedures.engine.order import order_of
    from procedures.planning.plan_model import FiducialKind
    from procedures.steps.catalogue import clinical_steps

    return order_of(
        clinical_steps(
            measure_targets=case.measure_targets,
            intraoperative=case.intraoperative,
            roles=case.roles,
            fiducials=FiducialKind.FREE if plan is None else plan.fiducials,
            start=case.methods.start,
        ),
        [] if plan is None else [trajectory.id for trajectory in plan.trajectories],
        localizes_per_trajectory=strategy_of(case, plan).localizes_per_trajectory,
    )


def prepare_case(
    request: RunRequest,
    folder: Path,
    theatre: Theatre,
    resumption: Resumption | None,
    held: contextlib.ExitStack,
) -> EngineInput:
    """Prepare the engine input of a case, and keep its plan locked until `held` closes.

    Raises the errors of reading the plan, PLAN-030 if its markers are adhesive, and PLAN-034 if the tracker
    cannot see them.
    """
    from procedures.calibration.validity import options_of, require_valid
    from procedures.engine.errors import RECOVERY_REFUSED
    from procedures.engine.setting import now_to_second
    from procedures.planning.plan_check import require_spheres
    from procedures.planning.plan_file import parse_plan_bytes
    from procedures.planning.plan_lock import lock_plan
    from procedures.planning.tool_records import ToolRecords
    from procedures.runs.engine_setup import EngineInput
    from procedures.runs.request_checks import require_fitting_options, require_one_change
    from procedures.workcell.tracker_look import require_tracked_spheres
    from ronna_hw.records import write_atomically
    from ronna_hw.registry import make_device

    case = request.case
    if resumption is not None and resumption.only_leaving:
        return EngineInput(restore_order(case, resumption.interrupted), clinical=clinical_input(case, folder))
    if resumption is None:  # before anybody is asked anything; set_up looks again
        now, choice = now_to_second(), request.choice
        arm = "" if choice.arm == DEFAULT_ARM else f" --arm {choice.arm}"
        simulated = f"--sim --scene {shlex.quote(choice.scene)} --seed {choice.seed}{arm}"
        options = simulated if request.config is None else options_of(request.config)
        require_valid(theatre.calibrations.of_arms(case.roles), now, options)
        ToolRecords.of(theatre.file).check(theatre.calibrations, now)
    file = case_folder(case, folder) / "plan.toml"
    if case.plan is not None and (resumption is None or resumption.interrupted.untouched):
        write_atomically(file, read_bounded(case.plan, LARGEST_TOML_BYTES))  # instead of the phantom's own
    try:
        locked = held.enter_context(lock_plan(file))
        plan = parse_plan_bytes(locked.content, file.name)
        require_spheres(plan)
        (require_fitting_options if resumption is None else require_one_change)(case, plan.fiducials)
    except RonnaError as problem:
        if resumption is None or resumption.interrupted.untouched:
            raise
        raise RECOVERY_REFUSED(
            f"the run cannot be resumed: {file} is not as it was",
            expected="the plan that the run was opened with",
            got=problem.summary,
        ) from problem
    if (tracker := theatre.file.tracker) is not None:  # not the theatre's own: the run's tape is not open yet
        require_tracked_spheres(make_device("tracker", tracker, theatre.clock), plan.fiducials)
    order = _build_order(case, plan)
    if request.answers is not None:
        request.answers.check_trajectories(order.trajectories)
    return EngineInput(order, clinical=clinical_input(case, folder, locked))
