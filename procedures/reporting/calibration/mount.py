"""Figures of the calibrations of what is on the mount: the reference frame and the guide's tip."""

from __future__ import annotations

import math
from collections.abc import Iterator

from procedures.reporting.calibration.figures import AXES, Figure, RecordFigures, expected_mm
from procedures.reporting.numbers import degrees, millimetres
from ronna_hw.calibration import Numbers3, Numbers4, PoseRecord


class FrameFigures(RecordFigures):
    """A calibration of the reference frame."""

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
        """Errors at held-out poses, the frame's position, and the contributions to its error."""
        yield Figure("frame", self.frame)
        yield Figure("poses", f"{self.poses - self.outliers} used, {self.outliers} left out")
        yield Figure("poses held out for validation", str(self.validation_poses))
        yield Figure("error at these, mm rms", expected_mm(self.validation_mm, self.predicted_mm))
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


class TipFigures(RecordFigures):
    """A calibration of the guide's tip."""

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
        """Errors at held-out readings, the tip's position, and the contributions to its error."""
        yield Figure("tool", str(self.tool_number))
        yield Figure("readings", str(self.readings))
        yield Figure("readings held out for validation", str(self.validation_readings))
        yield Figure("error at these, mm rms", expected_mm(self.validation_mm, self.predicted_mm))
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
