"""The plan, and the clearance along its checked paths."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.planning.plan_file import describe_seal
from procedures.reporting.pictures import Drawing, clearance_figure
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import PlanRow, plan_rows
from procedures.steps.clinical.plan_check import CheckedPlan


@dataclass(frozen=True)
class PlanSection:
    """Planned trajectories, and the clearance of the motions of each."""

    rows: tuple[PlanRow, ...]
    checked: CheckedPlan
    seal: str
    clearances: tuple[Drawing, ...]

    @property
    def localized_by(self) -> str:
        """The strategy for each trajectory in words; empty before the path check."""
        return ", ".join(f"{row.strategy} for {row.name}" for row in self.rows if row.strategy)


def read_plan(reading: RunReading) -> PlanSection | None:
    """Read the section, or return None before the plan check."""
    checked = reading.find(CheckedPlan)
    if checked is None:
        return None
    rows = plan_rows(reading)
    clearances = (Drawing(row.name, clearance_figure(row.name, row.motions)) for row in rows if row.motions)
    return PlanSection(rows, checked, describe_seal(checked.plan), tuple(clearances))
