"""The step order for bringing an arm home comes from the recorded plan, wherever the plan file is now."""

from __future__ import annotations

from pathlib import Path

from clinical_case import ClinicalCell, done_later
from prepared_results import checked_plan
from run_again import broken_off

from procedures.engine.case import StepKey
from procedures.engine.order import order_of
from procedures.journal.results import StepResult
from procedures.runs.case import restore_order
from procedures.runs.interrupted_run import read_interrupted_run
from procedures.runs.request import CaseProcedure


class Begun(StepResult, kind="begun"):
    """What was done before there was a plan."""


def test_the_order_comes_from_the_record_without_reading_a_plan_file(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "run")
    cell.begin(checked_plan()).run_to()
    broken_off(cell)
    order = restore_order(CaseProcedure(case=tmp_path / "gone"), read_interrupted_run(cell.folder))
    assert list(order.trajectories) == [trajectory.id for trajectory in checked_plan().plan.trajectories]
    assert StepKey("retreat", order.trajectories[-1]) in order.sequence


def test_an_order_without_a_checked_plan_has_no_steps_at_targets(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "run")
    cell.engine(order_of([done_later(Begun())], ())).run_to()
    broken_off(cell)
    order = restore_order(CaseProcedure(case=tmp_path / "gone"), read_interrupted_run(cell.folder))
    assert order.trajectories == ()
