"""Errors at the targets in detail, the work there, and the shares of the prediction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from procedures.engine.case import Stored
from procedures.operator.question import Topic
from procedures.reporting.error_parts import parts_figure
from procedures.reporting.pictures import target_figure
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import GuidePose, TargetTable
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import RegisteredBySurface
from procedures.strategies.pose_values import PoseValues
from ronna_hw.errors import RonnaError


@dataclass(frozen=True)
class Targets:
    """Errors and predictions of the targets, and the work at those that were reached."""

    table: TargetTable
    worked: tuple[Stored[ReachedTarget], ...]
    poses: tuple[GuidePose, ...]
    picture: str  # SVG
    parts_picture: str  # SVG, or "" where the truth of both parts is not known
    simulated: bool
    on_skin: bool  # registered without fiducials
    accepted_by_script: bool = False  # for any of them

    @property
    def told_acceptance(self) -> str:
        """Say who accepted the registration for its prediction, as a sentence."""
        if self.accepted_by_script:
            return "A script accepted the registration: nobody was asked about the prediction."
        return "The prediction was shown to the operator before the registration was accepted."


def read_targets(reading: RunReading, table: TargetTable, *, simulated: bool) -> Targets | None:
    """Read the section, or return None where nothing was registered."""
    if not table.rows:
        return None
    worked = reading.valid_results(ReachedTarget)
    fits = [one.result for one in reading.registrations]
    on_skin = all(isinstance(fit, RegisteredBySurface) and not fit.pairs for fit in fits)
    return Targets(
        table,
        worked,
        tuple(_read_poses(reading, worked)),
        target_figure(table.rows, simulated=simulated, on_skin=on_skin),
        parts_figure(table.split) if table.split else "",
        simulated,
        on_skin,
        any(reading.was_scripted(f"{Topic.REGISTRATION}:{row.target}") for row in table.rows),
    )


def _read_poses(reading: RunReading, worked: Sequence[Stored[ReachedTarget]]) -> Iterator[GuidePose]:
    """Yield the pose at each target; one that is none is noted and left out."""
    for one in worked:
        if one.result.tool_pose is None:
            continue
        try:
            yield GuidePose(one.record.trajectory, PoseValues.of(one.result.tool_pose.transform))
        except RonnaError as problem:
            reading.note(f"{one.record.identifier}: the pose of the guide is left out: {problem.what}")
