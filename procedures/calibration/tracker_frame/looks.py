"""Input of a reference frame calibration: arm poses, and the frame as the tracker sees it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.calibration.observations import Joints
from procedures.calibration.same_theatre import Measurements
from ronna_hw.calibration import (
    ArmCalibration,
    Dated,
    PoseRecord,
    StereoHeadCalibration,
    Strict,
    TrackerFrameCalibration,
)
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

LOOKS_FILE = "frame-looks.json"


class Use(StrEnum):
    """Purpose of a measurement."""

    FIT = "fit"
    VALIDATION = "validation"  # held out for validation
    RETURN = "return"  # repeated at the same pose: has anything moved?


class FrameLook(Strict):
    """One stationary pose, and the mean of the tracker's measurements there."""

    use: Annotated[Use, Field(strict=False)] = Field(description="Purpose of the measurement.")
    joints_rad: Joints = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: PoseRecord = Field(
        description="Pose robot <- flange, from the arm's record or nominal."
    )
    tracker_from_marker: PoseRecord = Field(description="Mean pose tracker <- reference frame.")
    frames: Annotated[int, Field(ge=1)] = Field(description="Measurements that show the frame.")


class FrameLooks(Measurements):
    """All measurements of one calibration, and the records in use."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")
    arm: str = Field(description="Name of the arm's kinematic model.")
    stereo_head: StereoHeadCalibration = Field(description="The record of the head on the same mount.")
    start: TrackerFrameCalibration = Field(description="The record in use, or the drawing.")
    arm_record: ArmCalibration | None = Field(default=None, description="The record of the arm in use.")
    looks: tuple[FrameLook, ...] = Field(description="The measurements, in order.")

    @property
    def records(self) -> Mapping[str, Dated | None]:
        """As `Measurements.records`."""
        return {"stereo_head": self.stereo_head, "tracker_frame": self.start, "arm": self.arm_record}


@dataclass(frozen=True)
class PosePairs:
    """Poses as matrices (m, 4, 4): ROBOT <- FLANGE from the arm, TRACKER <- MARKER from the tracker."""

    robot_from_flange: Array
    tracker_from_marker: Array

    @property
    def count(self) -> int:
        """Number of poses."""
        return len(self.robot_from_flange)

    def only(self, rows: NDArray[np.bool_]) -> PosePairs:
        """Selected poses."""
        return PosePairs(self.robot_from_flange[rows], self.tracker_from_marker[rows])


def uses_of(count: int, validation: int) -> tuple[Use, ...]:
    """Purpose of each measurement: those for validation are spread evenly among those for the fit."""
    total = count + validation
    judging = {round((number + 0.5) * total / validation) for number in range(validation)}
    return tuple(Use.VALIDATION if number in judging else Use.FIT for number in range(total))


def pairs_of(looks: Sequence[FrameLook]) -> PosePairs:
    """The measurements as arrays."""

    def matrices(poses: Sequence[Transform]) -> Array:
        return np.array([pose.as_matrix() for pose in poses]).reshape(-1, 4, 4)

    return PosePairs(
        matrices([one.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE) for one in looks]),
        matrices([one.tracker_from_marker.transform(Frame.TRACKER, Frame.MARKER) for one in looks]),
    )
