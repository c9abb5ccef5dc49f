"""Input of a tip calibration: ball and divot of one stand, in the same arm orientations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.calibration.observations import Joints
from procedures.calibration.same_theatre import Measurements
from ronna_hw.calibration import (
    ArmCalibration,
    Dated,
    Numbers3,
    PoseRecord,
    StereoHeadCalibration,
    Strict,
    ToolTipCalibration,
)
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

LOOKS_FILE = "tip-looks.json"


class BallLook(Strict):
    """The stereo head over the ball, in one orientation."""

    joints_rad: Joints = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: PoseRecord = Field(
        description="Pose robot <- flange, from the arm's record or nominal."
    )
    ball_mm: Numbers3 = Field(description="The ball in the tool frame of the head's record.")


class DivotReading(Strict):
    """The guide's tip in the divot, in the orientation of a view of the ball."""

    look: int = Field(ge=0, description="Number of that measurement.")
    joints_rad: Joints = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: PoseRecord = Field(
        description="Pose robot <- flange, from the arm's record or nominal."
    )
    dials_mm: Numbers3 = Field(description="Offset of the divot from the ball's centre, robot axes.")


class TipLooks(Measurements):
    """All views and readings of one calibration, and the records in use."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")
    arm: str = Field(description="Name of the arm's kinematic model.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head in use.")
    start: ToolTipCalibration = Field(description="The record of the tip in use, or the drawing.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[BallLook, ...] = Field(description="The measurements of the ball, in order.")
    readings: tuple[DivotReading, ...] = Field(description="The readings, at most one for each measurement.")
    validation: tuple[int, ...] = Field(description="Numbers of the measurements held out for validation.")

    @property
    def records(self) -> Mapping[str, Dated | None]:
        """As `Measurements.records`."""
        return {"stereo_head": self.stereo_head, "tool_tip": self.start, "arm": self.arm_record}


def kept_apart(count: int, validation: int) -> tuple[int, ...]:
    """Indices of those held out for validation: evenly distributed, in order of orientation."""
    return tuple(sorted({round((number + 0.5) * count / validation) for number in range(validation)}))


@dataclass(frozen=True)
class TipPairs:
    """Ball and divot in m orientations, in the head's tool frame according to its record."""

    at_ball: Array  # (m, 4, 4) ROBOT <- TOOL of the head over the ball
    at_divot: Array  # (m, 4, 4) the same with the tip in the divot
    ball_mm: Array  # (m, 3) tool frame
    dials_mm: Array  # (m, 3) robot axes

    @property
    def count(self) -> int:
        """Number of orientations."""
        return len(self.at_ball)

    def only(self, rows: NDArray[np.bool_]) -> TipPairs:
        """Selected orientations."""
        return TipPairs(*(getattr(self, field.name)[rows] for field in fields(self)))


def pairs_of(observed: TipLooks, readings: Sequence[DivotReading]) -> TipPairs:
    """The readings with their views, as arrays."""
    head = observed.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)

    def tools(poses: Sequence[PoseRecord]) -> Array:
        found: list[Transform] = [pose.transform(Frame.ROBOT, Frame.FLANGE) @ head for pose in poses]
        return np.array([one.as_matrix() for one in found]).reshape(-1, 4, 4)

    looks = [observed.looks[one.look] for one in readings]
    return TipPairs(
        at_ball=tools([one.robot_from_flange for one in looks]),
        at_divot=tools([one.robot_from_flange for one in readings]),
        ball_mm=np.array([one.ball_mm for one in looks]).reshape(-1, 3),
        dials_mm=np.array([one.dials_mm for one in readings]).reshape(-1, 3),
    )
