"""Errors at the targets in detail, the work there, and the shares of the prediction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from procedures.engine.case import Stored
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM
from procedures.reporting.pictures import target_figure
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import TargetTable
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import AssistedInsertion
from procedures.steps.clinical.two_arms.assisted_insertion import COAXIAL_MM, COAXIAL_RAD


class AssistedRow(NamedTuple):
    """Insertion by the assistant at a target."""

    target: str
    insertion: AssistedInsertion


@dataclass(frozen=True)
class Targets:
    """Errors and predictions of the targets, and the work at those that were reached."""

    table: TargetTable
    worked: tuple[Stored[ReachedTarget], ...]
    picture: str  # SVG
    simulated: bool
    coaxial_mm: float = COAXIAL_MM
    coaxial_rad: float = COAXIAL_RAD
    largest_off_mm: float = LARGEST_OFF_MM

    @property
    def assisted(self) -> tuple[AssistedRow, ...]:
        """Insertions by the assistant."""
        found = ((str(one.record.trajectory), one.result.assisted) for one in self.worked)
        return tuple(AssistedRow(target, insertion) for target, insertion in found if insertion)

    @property
    def force_unsensed(self) -> bool:
        """Whether the instrument was led in by an arm that senses no force."""
        return any(one.insertion.peak_force_N is None for one in self.assisted)


def read_targets(reading: RunReading, table: TargetTable, *, simulated: bool) -> Targets | None:
    """Read the section, or return None where nothing was registered."""
    if not table.rows:
        return None
    return Targets(
        table, reading.valid_results(ReachedTarget), target_figure(table.rows, simulated), simulated
    )
