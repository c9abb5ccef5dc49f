"""Figures of a calibration of the arm and of its check."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import Field

from procedures.reporting.calibration.figures import Figure, Figures, Numbers, RecordFigures, expected_mm
from procedures.reporting.numbers import millimetres

NOTHING_LEARNT = 0.97  # of a parameter's prior uncertainty


class ParameterFigures(Numbers):
    """One parameter of the arm model, in units of an uncalibrated arm's spread."""

    value: float
    standard_error: float


class ArmFigures(RecordFigures):
    """A calibration."""

    arm: str = Field(description="Name of the arm's kinematic model.")
    looks: int
    outliers: int
    validation_looks: int
    before_mm: float
    error_mm: float
    predicted_mm: float
    model_mm: float
    scatter_mm: float
    tool_shift_mm: float
    parameters: dict[str, ParameterFigures]

    def quality(self) -> Iterator[Figure]:
        """Errors at held-out measurements, and the parameters that the others did not determine."""
        yield Figure("measurements", f"{self.looks - self.outliers} used, {self.outliers} left out")
        yield Figure("measurements held out for validation", str(self.validation_looks))
        yield Figure("error at these, nominal arm, mm rms", millimetres(self.before_mm))
        yield Figure("calibrated arm, mm rms", expected_mm(self.error_mm, self.predicted_mm))
        yield Figure("expected from the calibration alone, mm", millimetres(self.model_mm))
        yield Figure("random error of the arm per axis, mm", millimetres(self.scatter_mm))
        yield Figure("shift of the head's tool centre, mm", millimetres(self.tool_shift_mm))
        unknown = [name for name, one in self.parameters.items() if one.standard_error > NOTHING_LEARNT]
        yield Figure("not determined by the measurements", ", ".join(unknown) or "nothing")


class ArmCheckFigures(Figures):
    """A check of a calibration."""

    calibration: str
    passed: bool
    looks: int
    error_mm: float
    expected_mm: float
    statistic: float
    limit: float

    def table(self) -> Iterator[Figure]:
        """The error of the arm, and whether it has changed."""
        yield Figure("measurements", str(self.looks))
        yield Figure(
            "error, mm rms",
            expected_mm(self.error_mm, self.expected_mm),
            verdict=f"{'unchanged' if self.passed else 'CHANGED'}: chi-square {self.statistic:.0f}, "
            f"limit {self.limit:.0f}",
        )
