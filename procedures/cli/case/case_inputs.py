"""What a case with a patient begins with: where CT and plan are, and the order of its steps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.request import CaseRequest

if TYPE_CHECKING:
    from procedures.engine.context import ClinicalInput
    from procedures.engine.left_run import LeftRun
    from procedures.engine.order import CaseOrder
    from procedures.planning.plan_lock import HeldPlan
    from procedures.planning.plan_model import Plan


def case_folder(request: CaseRequest, folder: Path) -> Path:
    """Where CT and plan of a run are."""
    return request.case or folder / "case"


def clinical_input(request: CaseRequest, folder: Path, plan: HeldPlan | None = None) -> ClinicalInput:
    """CT, plan and strategy of a run; its plan as it is held."""
    from procedures.engine.context import ClinicalInput
    from procedures.strategies.catalogue import strategy_named

    case = case_folder(request, folder)
    return ClinicalInput(
        case / "ct",
        case / "plan.toml",
        strategy_named(request.strategy),
        request.measure_targets,
        None if plan is None else plan.sha256,
    )


def order_of_case(request: CaseRequest, folder: Path, held: HeldPlan | None = None) -> CaseOrder:
    """The steps of a run, by its plan as held and its strategy. Raises what reading the plan raises."""
    from procedures.planning.plan_file import parse_plan_bytes, read_plan

    file = case_folder(request, folder) / "plan.toml"
    return _order(request, read_plan(file) if held is None else parse_plan_bytes(held.content, file.name))


def recorded_order(request: CaseRequest, left: LeftRun) -> CaseOrder:
    """The steps of a run that was left by the plan that it checked, whatever became of the file since.

    Raises REC-001, REC-003.
    """
    from procedures.steps.clinical.plan_check import CheckedPlan

    checked = left.run.made(CheckedPlan)
    return _order(request, checked[-1].result.plan if checked else None)


def _order(request: CaseRequest, plan: Plan | None) -> CaseOrder:
    from procedures.engine.order import order_of
    from procedures.steps.catalogue import clinical_steps
    from procedures.strategies.catalogue import strategy_named

    return order_of(
        clinical_steps(measure_targets=request.measure_targets),
        [] if plan is None else [trajectory.id for trajectory in plan.trajectories],
        localizes_per_trajectory=strategy_named(request.strategy).localizes_per_trajectory,
    )
