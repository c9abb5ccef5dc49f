"""Errors at the targets in detail, the work there, and the shares of the prediction."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.engine.case import Stored
from procedures.reporting.error_parts import parts_figure
from procedures.reporting.pictures import target_figure
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import TargetTable
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.strategies.pose_values import PoseValues


@dataclass(frozen=True)
class Targets:
    """Errors and predictions of the targets, and the work at those that were reached."""

    table: TargetTable
    worked: tuple[Stored[ReachedTarget], ...]
    picture: str  # SVG
    parts_picture: str  # SVG, or "" where the truth of both parts is not known
    simulated: bool

    @property
    def poses(self) -> tuple[tuple[str | None, PoseValues], ...]:
        """Trajectory and six values of each pose in which the guide was held."""
        return tuple(
            (one.record.trajectory, PoseValues.of(one.result.tool_pose.transform))
            for one in self.worked
            if one.result.tool_pose is not None
        )


def read_targets(reading: RunReading, table: TargetTable, *, simulated: bool) -> Targets | None:
    """Read the section, or return None where nothing was registered."""
    if not table.rows:
        return None
    return Targets(
        table,
        reading.valid_results(ReachedTarget),
        target_figure(table.rows, simulated),
        parts_figure(table.split) if table.split else "",
        simulated,
    )
