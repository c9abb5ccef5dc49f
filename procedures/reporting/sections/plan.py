"""The plan, and the clearance along its checked paths."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from procedures.planning.plan_file import describe_seal
from procedures.reporting.pictures import clearance_figure
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import MotionRow, PlanRow, list_skin_motions, plan_rows
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.strategies.skin_looks import SKIN

SKIN_FILE = "+skin"  # no trajectory has a plus sign in its name


@dataclass(frozen=True)
class Clearance:
    """Clearance of the motions to one trajectory, or over the skin: a drawing, and a file named by `stem`."""

    name: str
    stem: str
    motions: tuple[MotionRow, ...]

    @cached_property
    def picture(self) -> str:
        """The drawing as SVG."""
        return clearance_figure(self.name, self.motions)


@dataclass(frozen=True)
class PlanSection:
    """Planned trajectories, and the clearance of the motions of each and of the scan of the skin."""

    rows: tuple[PlanRow, ...]
    checked: CheckedPlan
    seal: str
    clearances: tuple[Clearance, ...]

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
    of_trajectories = [Clearance(row.name, row.name, row.motions) for row in rows]
    all_motions = (*of_trajectories, Clearance(SKIN, SKIN_FILE, list_skin_motions(reading)))
    clearances = tuple(one for one in all_motions if one.motions)
    return PlanSection(rows, checked, describe_seal(checked.plan), clearances)
