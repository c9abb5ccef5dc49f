"""Figures of a calibration of the stereo head and of its check."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pydantic import Field

from procedures.calibration.bundle import REPEATABILITY_MM
from procedures.reporting.calibration.figures import AXES, Figure, Figures, Matrix3, Numbers, RecordFigures
from procedures.reporting.numbers import micrometres, millimetres
from ronna_hw.calibration import Numbers3, PoseRecord

SLIP_OF_CHECK_MM = 0.05  # noticed by `ronna-stereo check`, whatever the arm: it compares equal poses


class HeadFigures(RecordFigures):
    """A calibration: both cameras, and the tool frame on the flange."""

    serials: tuple[str, str] = Field(description="Of the left and the right camera.")
    poses: int
    outliers: tuple[int, ...] = Field(description="Measurements that were left out.")
    image_sigma_px: float
    arm_error_mm: float
    arm_scatter_mm: float
    stated_error_mm: float = Field(description="Of a point measured in the tool frame.")
    tool_error_mm: float = Field(description="Of the tool centre on the flange.")
    tool_covariance_mm2: Matrix3
    tool_shift_mm: float
    frame_misfit_mm: float
    smallest_slip_mm: float | None = Field(
        default=None,
        description="Shift of the tool centre from which on the head has moved; absent if not compared.",
    )
    head_moved: bool = Field(description="On its mount, since the previous calibration.")
    ball_mm: Numbers3 = Field(description="In the robot frame.")
    flange_from_tool: PoseRecord
    residuals_px: tuple[tuple[float, ...], ...] = Field(description="Of each measurement, both images.")
    shifts_mm: tuple[Numbers3, ...] = Field(description="Arm error at each measurement.")

    @property
    def looks_px(self) -> tuple[tuple[float, bool], ...]:
        """Rms residual of each view, and whether it was used."""
        return tuple(
            (math.sqrt(sum(value**2 for value in one) / len(one)), number not in self.outliers)
            for number, one in enumerate(self.residuals_px)
            if one
        )

    def quality(self) -> Iterator[Figure]:
        """The tool centre with its standard error, and what the residuals say of cameras and arm."""
        used = [value for value, is_used in self.looks_px if is_used]
        rms_px = math.sqrt(sum(value**2 for value in used) / max(len(used), 1))
        yield Figure("cameras", f"{self.serials[0]} left, {self.serials[1]} right")
        yield Figure("measurements", f"{len(used)} used, {len(self.outliers)} left out")
        for number, axis in enumerate(AXES):
            sigma_mm = math.sqrt(self.tool_covariance_mm2[number][number])
            value_mm = self.flange_from_tool.translation_mm[number]
            yield Figure(
                f"tool centre on the flange, {axis}, mm", millimetres(value_mm), millimetres(sigma_mm)
            )
        yield Figure(
            "shift of the tool centre, mm", millimetres(self.tool_shift_mm), millimetres(self.tool_error_mm)
        )
        slip = "not compared" if self.smallest_slip_mm is None else millimetres(self.smallest_slip_mm)
        yield Figure("smallest slip on the mount that would show, mm", slip)
        yield Figure("error of a point in the tool frame, mm", "", millimetres(self.stated_error_mm))
        yield Figure("change of the stereo geometry, mm", millimetres(self.frame_misfit_mm))
        yield Figure("rms residual, arm errors included, px", f"{rms_px:.2f}")
        yield Figure("standard error of an outline, px", f"{self.image_sigma_px:.3f}")
        yield Figure("arm error, mm per axis and pose", millimetres(self.arm_error_mm))
        yield Figure("arm error, random part, mm", millimetres(self.arm_scatter_mm))

    def warnings(self) -> Iterator[str]:
        """When the head has moved on its mount or may have unnoticed, and when the arm was worse than it
        repeats."""
        if self.head_moved:
            yield (
                f"the tool centre is {self.tool_shift_mm:.2f} mm from where the previous calibration had it, "
                "so the head has moved on the mount. Reference frame and guide have not moved with it: "
                "repeat ronna-procedure calibrate tracker-frame and tool-tip before the next case"
            )
        elif self.smallest_slip_mm is not None and self.smallest_slip_mm > SLIP_OF_CHECK_MM:
            yield (
                f"a slip of the head on its mount of less than {self.smallest_slip_mm:.2f} mm since the "
                "previous calibration does not show in this one; ronna-stereo check with the baseline of "
                f"that one notices {SLIP_OF_CHECK_MM:g} mm"
            )
        if self.arm_error_mm > REPEATABILITY_MM:
            yield (
                f"the arm error over these poses, {self.arm_error_mm:.2f} mm per axis, exceeds its "
                f"repeatability of {REPEATABILITY_MM:g} mm. The standard error covers what the last link "
                "adds to the tool centre; calibrate the arm before using a strategy that rotates the tool"
            )


class SignFigures(Numbers):
    """One sign of a change: its value with standard error, and its chi-square statistic."""

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    statistic: float
    limit: float
    sounds: bool = Field(description="Whether the statistic exceeds its limit.")


class HeadCheckFigures(Figures):
    """A check against the baseline of a calibration."""

    calibration: str
    baseline_created: str
    passed: bool
    looks: int
    repeatability_mm: float
    ball_moved_mm: Numbers3
    signs: tuple[SignFigures, ...]

    def table(self) -> Iterator[Figure]:
        """The signs of a change, and where the ball is now."""
        yield Figure("calibration", self.calibration)
        yield Figure(
            "measurements", str(self.looks), f"arm: {micrometres(self.repeatability_mm)} µm per axis"
        )
        for sign in self.signs:
            yield Figure(
                f"{sign.name}, {sign.unit}",
                " ".join(f"{value:.5f}" for value in sign.value),
                " ".join(f"{value:.5f}" for value in sign.sigma),
                f"{'changed' if sign.sounds else 'unchanged'}: chi-square {sign.statistic:.1f}, "
                f"limit {sign.limit:.1f}",
            )
        yield Figure("ball moved in $ROBROOT, mm", " ".join(map(millimetres, self.ball_moved_mm)))
