"""What a case with a patient begins with: where CT and plan are, and the order of its steps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.request import CaseRequest

if TYPE_CHECKING:
    from procedures.engine.context import ClinicalInput
    from procedures.engine.order import CaseOrder


def case_folder(request: CaseRequest, folder: Path) -> Path:
    """Where CT and plan of a run are."""
    return request.case or folder / "case"


def clinical_input(request: CaseRequest, folder: Path) -> ClinicalInput:
    """CT, plan and strategy of a run."""
    from procedures.engine.context import ClinicalInput
    from procedures.strategies.catalogue import strategy_named

    case = case_folder(request, folder)
    return ClinicalInput(
        case / "ct",
        case / "plan.toml",
        strategy_named(request.strategy),
        request.measure_targets,
    )


def order_of_case(request: CaseRequest, folder: Path) -> CaseOrder:
    """The steps of a run, by its plan and its strategy. Raises what reading the plan raises."""
    from procedures.engine.order import order_of
    from procedures.planning.plan_file import read_plan
    from procedures.steps.catalogue import clinical_steps
    from procedures.strategies.catalogue import strategy_named

    plan = read_plan(case_folder(request, folder) / "plan.toml")
    return order_of(
        clinical_steps(measure_targets=request.measure_targets),
        [trajectory.id for trajectory in plan.trajectories],
        localizes_per_trajectory=strategy_named(request.strategy).localizes_per_trajectory,
    )
