"""Calibration records of the theatre: what was measured, when, how well, until when it holds.

They are plain numbers in the theatre file. Poses are given as translation (mm) and scalar-first quaternion.
"""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ronna_hw.errors import EXIT_REFUSED, DataError

if TYPE_CHECKING:
    from ronna_hw.frames import Frame, Transform

UNIT_NORM_TOLERANCE = 1e-6
Numbers3 = tuple[float, float, float]
Numbers4 = tuple[float, float, float, float]


class CalibrationExpired(DataError):
    """A calibration record is older than it may be."""

    code = "CAL-001"
    action = "Repeat the calibration, or have the record's owner extend it; no motion until then."
    exit_code = EXIT_REFUSED


class Strict(BaseModel):
    """Base of every model of the theatre file: strict types, finite numbers, no unknown keys, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PoseRecord(Strict):
    """A rigid pose `target <- source`; which frames is said by the field that holds it."""

    translation_mm: Numbers3
    quaternion_wxyz: Numbers4

    @model_validator(mode="after")
    def _unit(self) -> Self:
        norm = sum(value * value for value in self.quaternion_wxyz) ** 0.5
        if abs(norm - 1.0) > UNIT_NORM_TOLERANCE:
            raise ValueError(f"quaternion_wxyz has norm {norm:.6f}, not 1")
        return self

    def transform(self, target: Frame, source: Frame) -> Transform:
        """The pose as a checked transform."""
        from ronna_hw.frames import Transform

        return Transform.of(
            target, source, translation_mm=self.translation_mm, quaternion_wxyz=self.quaternion_wxyz
        )


class CameraCalibration(Strict):
    """One camera of the stereo head: pinhole with radial and tangential distortion.

    Pixel (0, 0) is the centre of the sensor's top-left pixel. `camera_from_tool` maps tool coordinates
    to the camera frame (z along the optical axis, x along columns, y down the rows).
    """

    serial: str
    focal_px: tuple[float, float]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3
    sensor_px: tuple[int, int] = (2048, 1088)
    camera_from_tool: PoseRecord


class DatedRecord(Strict):
    """What every calibration says about itself."""

    identifier: str
    created: datetime
    expires: datetime
    made_by: str
    stated_error_mm: Annotated[float, Field(ge=0)]

    def check_valid_at(self, moment: datetime) -> None:
        """Raise CAL-001 when the record has expired at `moment`."""
        if moment > self.expires:
            raise CalibrationExpired(
                f"calibration {self.identifier} expired",
                limit=self.expires.isoformat(),
                last=moment.isoformat(),
            )


class StereoHeadCalibration(DatedRecord):
    """Both cameras, and where the head's tool centre point is thought to sit on the flange."""

    flange_from_tool: PoseRecord
    left: CameraCalibration
    right: CameraCalibration


class ToolTipCalibration(DatedRecord):
    """A surgical guide: where its tip is thought to sit on the flange, z along the guide's axis."""

    tool_number: Annotated[int, Field(ge=1, le=16)]  # as the controller's inputs report it
    flange_from_tool: PoseRecord


class TrackerFrameCalibration(DatedRecord):
    """The reference frame M on the tool mount: its definition file's tool name and its pose."""

    tool: str
    tool_from_marker: PoseRecord
