"""Results of calibrations, checks and measurements, and `result.json` with the `--json` output.

The kind of the figures is recognized by a key that no other kind has. A key `kind` would be new in the output
of `--json`, and files written before it would still have to be recognized by their content.
"""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from procedures.calibration.bundle import REPEATABILITY_MM
from procedures.reporting.numbers import degrees, micrometres, millimetres
from ronna_hw.bounded_input import parse_json, read_json_bytes
from ronna_hw.calibration import Numbers2, Numbers3, Numbers4, PoseRecord
from ronna_hw.evidence.manifest import RESULT_FILE
from ronna_hw.records import write_atomically

AXES = ("x", "y", "z")
Matrix3 = tuple[Numbers3, Numbers3, Numbers3]
SLIP_OF_CHECK_MM = 0.05  # noticed by `ronna-stereo check`, whatever the arm: it compares equal poses
NOTHING_LEARNT = 0.97  # of a parameter's prior uncertainty


class Figure(NamedTuple):
    """Row of the results table. `spread` is the standard error in the unit of the value."""

    name: str
    value: str
    spread: str = ""
    verdict: str = ""


class LookResidual(NamedTuple):
    """Rms residual of one look of a calibration, and whether the look was used."""

    rms_px: float
    used: bool


class Numbers(BaseModel):
    """Base of result values. The fields are the keys of `--json`, in the same order."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, from_attributes=True)


class Figures(Numbers, ABC):
    """All figures of a result."""

    def as_json(self) -> dict[str, Any]:
        """Return the object that `--json` prints."""
        return self.model_dump(mode="json")

    @abstractmethod
    def table(self) -> Iterator[Figure]:
        """Yield the figures shown to the operator."""


class RecordFigures(Figures):
    """Figures of a calibration that created a dated record."""

    calibration: str
    created: str
    expires: str

    @abstractmethod
    def quality(self) -> Iterator[Figure]:
        """Yield the measurements and the accuracy of the record."""

    def table(self) -> Iterator[Figure]:
        """Yield the quality figures and the validity period of the record."""
        yield from self.quality()
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))

    def warnings(self) -> Iterator[str]:
        """Yield warnings for the operator, to be read before the record is used."""
        yield from ()


def expected_mm(value_mm: float, predicted_mm: float) -> str:
    """Format an rms error with its predicted value, in millimetres."""
    return f"{millimetres(value_mm)}, expected {millimetres(predicted_mm)}"


class HeadFigures(RecordFigures):
    """Figures of a head calibration: both cameras, and the tool frame on the flange."""

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
    def looks_px(self) -> tuple[LookResidual, ...]:
        """Residual of each look."""
        return tuple(
            LookResidual(math.sqrt(sum(value**2 for value in one) / len(one)), number not in self.outliers)
            for number, one in enumerate(self.residuals_px)
            if one
        )

    def quality(self) -> Iterator[Figure]:
        used = [one.rms_px for one in self.looks_px if one.used]
        rms_px = math.sqrt(sum(value**2 for value in used) / max(len(used), 1))
        yield Figure("cameras", f"{self.serials[0]} left, {self.serials[1]} right")
        yield Figure("measurements", f"{len(used)} used, {len(self.outliers)} left out")
        for number, axis in enumerate(AXES):
            sigma = millimetres(math.sqrt(self.tool_covariance_mm2[number][number]))
            value = millimetres(self.flange_from_tool.translation_mm[number])
            yield Figure(f"tool centre on the flange, {axis}, mm", value, sigma)
        shift, error = millimetres(self.tool_shift_mm), millimetres(self.tool_error_mm)
        yield Figure("shift of the tool centre, mm", shift, error)
        slip = "not compared" if self.smallest_slip_mm is None else millimetres(self.smallest_slip_mm)
        yield Figure("smallest slip on the mount that would show, mm", slip)
        yield Figure("error of a point in the tool frame, mm", "", millimetres(self.stated_error_mm))
        yield Figure("change of the stereo geometry, mm", millimetres(self.frame_misfit_mm))
        yield Figure("rms residual, arm errors included, px", f"{rms_px:.2f}")
        yield Figure("standard error of an outline, px", f"{self.image_sigma_px:.3f}")
        yield Figure("arm error, mm per axis and pose", millimetres(self.arm_error_mm))
        yield Figure("arm error, random part, mm", millimetres(self.arm_scatter_mm))

    def warnings(self) -> Iterator[str]:
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
    """Indicator of a change: value with standard error, and chi-square statistic."""

    name: str
    unit: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    statistic: float
    limit: float
    sounds: bool = Field(description="Whether the statistic exceeds its limit.")


class HeadCheckFigures(Figures):
    """Figures of a head check against the baseline of its calibration."""

    calibration: str
    baseline_created: str
    passed: bool
    looks: int
    repeatability_mm: float
    ball_moved_mm: Numbers3
    signs: tuple[SignFigures, ...]

    def table(self) -> Iterator[Figure]:
        yield Figure("calibration", self.calibration)
        repeatability = f"arm: {micrometres(self.repeatability_mm)} µm per axis"
        yield Figure("measurements", str(self.looks), repeatability)
        for sign in self.signs:
            yield Figure(
                f"{sign.name}, {sign.unit}",
                " ".join(f"{value:.5f}" for value in sign.value),
                " ".join(f"{value:.5f}" for value in sign.sigma),
                f"{'changed' if sign.sounds else 'unchanged'}: chi-square {sign.statistic:.1f}, "
                f"limit {sign.limit:.1f}",
            )
        yield Figure("ball moved in $ROBROOT, mm", " ".join(map(millimetres, self.ball_moved_mm)))


class ParameterFigures(Numbers):
    """Parameter of the arm model, in units of its spread among uncalibrated arms."""

    value: float
    standard_error: float


class ArmFigures(RecordFigures):
    """Figures of an arm calibration."""

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
    """Figures of an arm check."""

    calibration: str
    passed: bool
    looks: int
    error_mm: float
    expected_mm: float
    statistic: float
    limit: float

    def table(self) -> Iterator[Figure]:
        yield Figure("measurements", str(self.looks))
        yield Figure(
            "error, mm rms",
            expected_mm(self.error_mm, self.expected_mm),
            verdict=f"{'unchanged' if self.passed else 'CHANGED'}: chi-square {self.statistic:.0f}, "
            f"limit {self.limit:.0f}",
        )


class FrameFigures(RecordFigures):
    """Figures of a reference frame calibration."""

    frame: str
    poses: int
    outliers: int
    validation_poses: int
    tool_from_marker: PoseRecord
    flange_from_marker: tuple[Numbers4, Numbers4, Numbers4, Numbers4]
    error_mm: float
    error_rad: float
    arm_error_mm: float
    stated_error_mm: float
    scatter_mm: float
    scatter_rad: float
    validation_mm: float
    validation_rad: float
    predicted_mm: float
    predicted_rad: float
    change_mm: float
    change_rad: float

    def quality(self) -> Iterator[Figure]:
        yield Figure("frame", self.frame)
        yield Figure("poses", f"{self.poses - self.outliers} used, {self.outliers} left out")
        yield Figure("poses held out for validation", str(self.validation_poses))
        yield Figure("error at these, mm rms", expected_mm(self.validation_mm, self.predicted_mm))
        turned = f"{degrees(self.validation_rad)}, expected {degrees(self.predicted_rad)}"
        yield Figure("error at these, degrees rms", turned)
        for axis, value_mm in zip(AXES, self.tool_from_marker.translation_mm, strict=True):
            yield Figure(f"frame in the tool frame, {axis}, mm", millimetres(value_mm))
        yield Figure("found on this arm, mm", "", millimetres(self.error_mm))
        yield Figure("found on this arm, degrees", "", degrees(self.error_rad))
        yield Figure("contribution of the arm, mm", "", millimetres(self.arm_error_mm))
        yield Figure("stated error, mm", "", millimetres(self.stated_error_mm))
        scatter = f"{millimetres(self.scatter_mm)} mm, {degrees(self.scatter_rad)} degrees"
        yield Figure("arm and tracker, scatter per axis", scatter)
        change = f"{millimetres(self.change_mm)} mm, {degrees(self.change_rad)} degrees"
        yield Figure("change from the former record", change)


class TipFigures(RecordFigures):
    """Figures of a guide tip calibration."""

    tool_number: int
    readings: int
    validation_readings: int
    tip_in_head_mm: Numbers3
    flange_from_tool: PoseRecord
    error_mm: float
    stated_error_mm: float
    stated_direction_error_rad: float
    reading_scatter_mm: float
    validation_mm: float
    predicted_mm: float
    gap_mm: Numbers3
    gap_error_mm: float
    change_mm: float

    def quality(self) -> Iterator[Figure]:
        yield Figure("tool", str(self.tool_number))
        yield Figure("readings", str(self.readings))
        yield Figure("readings held out for validation", str(self.validation_readings))
        yield Figure("error at these, mm rms", expected_mm(self.validation_mm, self.predicted_mm))
        for axis, value_mm in zip(AXES, self.tip_in_head_mm, strict=True):
            yield Figure(f"tip in the tool frame of the head, {axis}, mm", millimetres(value_mm))
        yield Figure("from these readings, mm", "", millimetres(self.error_mm))
        yield Figure("stated error, including the stand, mm", "", millimetres(self.stated_error_mm))
        yield Figure("scatter of a reading per axis, mm", millimetres(self.reading_scatter_mm))
        gap, error = millimetres(math.hypot(*self.gap_mm)), millimetres(self.gap_error_mm)
        yield Figure("offset of the divot from the ball by pivoting, mm", gap, error)
        yield Figure("change from the former record, mm", millimetres(self.change_mm))


class OutlineFigures(Numbers):
    """Outline of the ball in one image, full-sensor pixels, major semi-axis first."""

    centre_px: Numbers2
    axes_px: Numbers2
    quality: float
    status: str
    rim_fraction: float
    scatter_px: float
    blur_px: float


class BallFigures(Figures):
    """Figures of the ball in the tool frame and in both images."""

    position_mm: Numbers3
    covariance_mm2: Matrix3
    ray_gap_mm: float
    radius_mm: float
    left: OutlineFigures
    right: OutlineFigures

    def table(self) -> Iterator[Figure]:
        for number, axis in enumerate(AXES):
            sigma = f"{math.sqrt(self.covariance_mm2[number][number]):.4f}"
            yield Figure(f"ball in the tool frame, {axis}, mm", f"{self.position_mm[number]:.4f}", sigma)
        yield Figure("gap of the lines of sight, µm", micrometres(self.ray_gap_mm))
        yield Figure("radius, mm", millimetres(self.radius_mm))


KINDS: dict[str, type[Figures]] = {
    "residuals_px": HeadFigures,
    "signs": HeadCheckFigures,
    "position_mm": BallFigures,
    "parameters": ArmFigures,
    "expected_mm": ArmCheckFigures,
    "tool_from_marker": FrameFigures,
    "tip_in_head_mm": TipFigures,
}


def write_figures(figures: Figures, folder: Path) -> None:
    """Write the figures to a run folder for the report."""
    content = json.dumps(figures.as_json(), indent=1, allow_nan=False)
    write_atomically(folder / RESULT_FILE, content.encode())


def read_figures(folder: Path) -> Figures:
    """Read the figures from a run folder. Raises OSError, or ValueError if they are invalid."""
    content = read_json_bytes(folder / RESULT_FILE)
    found = parse_json(content)
    for key, kind in KINDS.items():
        if isinstance(found, dict) and key in found:
            return kind.model_validate_json(content)
    raise ValueError("it has no figures of a calibration")


def load_figures(folder: Path) -> Figures | None:
    """Read the figures from a run folder, or return None if missing or unreadable."""
    try:
        return read_figures(folder)
    except (OSError, ValueError):
        return None
