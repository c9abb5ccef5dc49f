"""Result of a stereo head calibration, a check of it or one measurement: every figure with its spread."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from procedures.reporting.numbers import degrees, micrometres, millimetres
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import Numbers3
from ronna_hw.errors import RonnaError

RESULT_FILE = "result.json"  # in the folder of the run: the output of the command's --json
AXES = ("x", "y", "z")
NOTHING_LEARNT = 0.97  # of a parameter's prior uncertainty


class Figure(NamedTuple):
    """One line of the table; `spread` is the standard error, in the unit of the value."""

    name: str
    value: str
    spread: str = ""
    verdict: str = ""


class _Figures(BaseModel):
    """Numbers written by a command; what a report does not show is ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class _Place(_Figures):
    translation_mm: Numbers3


class HeadFigures(_Figures):
    """A calibration."""

    calibration: str
    created: str
    expires: str
    serials: tuple[str, str]
    outliers: tuple[int, ...] = Field(description="Measurements that were left out.")
    image_sigma_px: float
    arm_error_mm: float
    arm_scatter_mm: float
    stated_error_mm: float
    tool_covariance_mm2: tuple[Numbers3, Numbers3, Numbers3]
    tool_shift_mm: float
    frame_misfit_mm: float
    flange_from_tool: _Place
    residuals_px: tuple[tuple[float, ...], ...] = Field(description="Rms of each measurement.")

    @property
    def looks_px(self) -> tuple[tuple[float, bool], ...]:
        """Rms residual of each view, and whether it was used."""
        return tuple(
            (math.sqrt(sum(value**2 for value in one) / len(one)), number not in self.outliers)
            for number, one in enumerate(self.residuals_px)
            if one
        )

    def figures(self) -> Iterator[Figure]:
        """As a table."""
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
            "shift of the tool centre, mm", millimetres(self.tool_shift_mm), millimetres(self.stated_error_mm)
        )
        yield Figure("change of the stereo geometry, mm", millimetres(self.frame_misfit_mm))
        yield Figure("rms residual, arm errors included, px", f"{rms_px:.2f}")
        yield Figure("standard error of an outline, px", f"{self.image_sigma_px:.3f}")
        yield Figure("arm error, mm per axis and pose", millimetres(self.arm_error_mm))
        yield Figure("arm error, random part, mm", millimetres(self.arm_scatter_mm))
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))


class _Sign(_Figures):
    name: str
    unit: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    statistic: float
    limit: float
    sounds: bool


class CheckFigures(_Figures):
    """A check of a calibration."""

    calibration: str
    looks: int
    repeatability_mm: float
    ball_moved_mm: Numbers3
    signs: tuple[_Sign, ...]

    def figures(self) -> Iterator[Figure]:
        """As a table."""
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


class LookFigures(_Figures):
    """One measurement."""

    position_mm: Numbers3
    covariance_mm2: tuple[Numbers3, Numbers3, Numbers3]
    ray_gap_mm: float
    radius_mm: float

    def figures(self) -> Iterator[Figure]:
        """As a table."""
        for number, axis in enumerate(AXES):
            sigma_mm = math.sqrt(self.covariance_mm2[number][number])
            yield Figure(
                f"ball in the tool frame, {axis}, mm",
                f"{self.position_mm[number]:.4f}",
                f"{sigma_mm:.4f}",
            )
        yield Figure("gap of the lines of sight, µm", micrometres(self.ray_gap_mm))
        yield Figure("radius, mm", millimetres(self.radius_mm))


class _Parameter(_Figures):
    value: float
    standard_error: float


class ArmFigures(_Figures):
    """A calibration of the arm."""

    calibration: str
    created: str
    expires: str
    looks: int
    outliers: int
    validation_looks: int
    before_mm: float
    error_mm: float
    predicted_mm: float
    model_mm: float
    scatter_mm: float
    tool_shift_mm: float
    parameters: dict[str, _Parameter] = Field(description="In units of an uncalibrated arm's spread.")

    def figures(self) -> Iterator[Figure]:
        """As a table."""
        yield Figure("measurements", f"{self.looks - self.outliers} used, {self.outliers} left out")
        yield Figure("measurements held out for validation", str(self.validation_looks))
        yield Figure("error at these, nominal arm, mm rms", millimetres(self.before_mm))
        yield Figure(
            "calibrated arm, mm rms",
            f"{millimetres(self.error_mm)}, expected {millimetres(self.predicted_mm)}",
        )
        yield Figure("expected from the calibration alone, mm", millimetres(self.model_mm))
        yield Figure("random error of the arm per axis, mm", millimetres(self.scatter_mm))
        yield Figure("shift of the head's tool centre, mm", millimetres(self.tool_shift_mm))
        unknown = [name for name, one in self.parameters.items() if one.standard_error > NOTHING_LEARNT]
        yield Figure("not determined by the measurements", ", ".join(unknown) or "nothing")
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))


class ArmCheckFigures(_Figures):
    """A check of an arm's calibration."""

    calibration: str
    passed: bool
    looks: int
    error_mm: float
    expected_mm: float
    statistic: float
    limit: float

    def figures(self) -> Iterator[Figure]:
        """As a table."""
        yield Figure("measurements", str(self.looks))
        yield Figure(
            "error, mm rms",
            f"{millimetres(self.error_mm)}, expected {millimetres(self.expected_mm)}",
            "",
            f"{'unchanged' if self.passed else 'CHANGED'}: chi-square {self.statistic:.0f}, "
            f"limit {self.limit:.0f}",
        )


class FrameFigures(_Figures):
    """A calibration of the reference frame on the mount."""

    calibration: str
    created: str
    expires: str
    frame: str
    poses: int
    outliers: int
    validation_poses: int
    tool_from_marker: _Place
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

    def figures(self) -> Iterator[Figure]:
        """As a table."""
        yield Figure("frame", self.frame)
        yield Figure("poses", f"{self.poses - self.outliers} used, {self.outliers} left out")
        yield Figure("poses held out for validation", str(self.validation_poses))
        yield Figure(
            "error at these, mm rms",
            f"{millimetres(self.validation_mm)}, expected {millimetres(self.predicted_mm)}",
        )
        yield Figure(
            "error at these, degrees rms",
            f"{degrees(self.validation_rad)}, expected {degrees(self.predicted_rad)}",
        )
        for axis, value_mm in zip(AXES, self.tool_from_marker.translation_mm, strict=True):
            yield Figure(f"frame in the tool frame, {axis}, mm", millimetres(value_mm))
        yield Figure("found on this arm, mm", "", millimetres(self.error_mm))
        yield Figure("found on this arm, degrees", "", degrees(self.error_rad))
        yield Figure("contribution of the arm, mm", "", millimetres(self.arm_error_mm))
        yield Figure("stated error, mm", "", millimetres(self.stated_error_mm))
        yield Figure(
            "arm and tracker, scatter per axis",
            f"{millimetres(self.scatter_mm)} mm, {degrees(self.scatter_rad)} degrees",
        )
        yield Figure(
            "change from the former record",
            f"{millimetres(self.change_mm)} mm, {degrees(self.change_rad)} degrees",
        )
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))


class TipFigures(_Figures):
    """A calibration of the guide's tip."""

    calibration: str
    created: str
    expires: str
    tool_number: int
    readings: int
    validation_readings: int
    tip_in_head_mm: Numbers3
    error_mm: float
    stated_error_mm: float
    reading_scatter_mm: float
    validation_mm: float
    predicted_mm: float
    gap_mm: Numbers3
    gap_error_mm: float
    change_mm: float

    def figures(self) -> Iterator[Figure]:
        """As a table."""
        yield Figure("tool", str(self.tool_number))
        yield Figure("readings", str(self.readings))
        yield Figure("readings held out for validation", str(self.validation_readings))
        yield Figure(
            "error at these, mm rms",
            f"{millimetres(self.validation_mm)}, expected {millimetres(self.predicted_mm)}",
        )
        for axis, value_mm in zip(AXES, self.tip_in_head_mm, strict=True):
            yield Figure(f"tip in the tool frame of the head, {axis}, mm", millimetres(value_mm))
        yield Figure("from these readings, mm", "", millimetres(self.error_mm))
        yield Figure("stated error, including the stand, mm", "", millimetres(self.stated_error_mm))
        yield Figure("scatter of a reading per axis, mm", millimetres(self.reading_scatter_mm))
        yield Figure(
            "offset of the divot from the ball by pivoting, mm",
            millimetres(math.hypot(*self.gap_mm)),
            millimetres(self.gap_error_mm),
        )
        yield Figure("change from the former record, mm", millimetres(self.change_mm))
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))


AnyFigures = (
    HeadFigures | CheckFigures | LookFigures | FrameFigures | TipFigures | ArmFigures | ArmCheckFigures
)


def read_figures(folder: Path) -> AnyFigures | None:
    """What the command wrote; None if there is nothing, or nothing readable."""
    try:
        content = read_json_bytes(folder / RESULT_FILE)
    except (OSError, RonnaError):
        return None
    kinds: tuple[type[AnyFigures], ...] = get_args(AnyFigures)
    for kind in kinds:
        try:
            return kind.model_validate_json(content)
        except ValidationError:
            continue
    return None
