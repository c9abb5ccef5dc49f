"""Predicted and true error at each target, from the records and the theatre's truth."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.reporting.numbers import millimetres, tenths
from procedures.reporting.outcome import Truth
from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import Prediction
from procedures.steps.clinical.target_measurement import MeasuredTarget


@dataclass(frozen=True)
class TargetRow:
    """One target; the error is known only against a simulated truth, and only if the tip arrived."""

    target: str
    depth_mm: float | None
    predicted: Prediction
    error_mm: float | None
    lateral_mm: float | None
    axial_mm: float | None
    measured_mm: float | None = None  # by the stereo head in place of the guide, on a phantom

    @property
    def cells(self) -> tuple[str, ...]:
        """As in the report's table: target, depth, prediction, its limit, error."""
        return (
            self.target,
            tenths(self.depth_mm),
            millimetres(self.predicted.rms_mm),
            millimetres(self.predicted.limit_mm),
            millimetres(self.error_mm),
        )


def target_rows(reading: RunReading, truth: Truth) -> tuple[TargetRow, ...]:
    """A row for each registered target, with the prediction of its registration."""
    plan = reading.find(CheckedPlan)
    depth_mm = {} if plan is None else {one.id: one.depth_mm for one in plan.plan.trajectories}
    true = {one.id: one for one in truth.targets}
    measured_mm = {one.record.trajectory: one.result.error_mm for one in reading.standing(MeasuredTarget)}
    rows = []
    for used in reading.registrations:
        for predicted in used.predictions:
            at = true.get(predicted.target)
            rows.append(
                TargetRow(
                    predicted.target,
                    depth_mm.get(predicted.target),
                    predicted,
                    None if at is None else at.application_error_mm,
                    None if at is None else at.lateral_mm,
                    None if at is None else at.axial_mm,
                    measured_mm.get(predicted.target),
                )
            )
    return tuple(rows)
