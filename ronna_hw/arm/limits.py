"""How fast the arm works: a small, fixed part of what it could do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ronna_hw.arm.errors import MotionInvalid
from ronna_hw.arm.model import ArmModel
from ronna_hw.devices.readings import JointVector
from ronna_hw.wire.kuka_eki import OperationMode

WORKING_SPEED_FRACTION = 0.12  # below 1/8 of full speed one lost packet stays a small step for the controller
WORKING_ACCELERATION_FRACTION = 0.25  # of the planner's accelerations
ACCELERATION_RAMP_S = 0.08  # time from none to full acceleration: sets the jerk
WORKING_LINE_SPEED_MM_S = 100.0  # below half of what a controller allows beside a person (250 mm/s)
WORKING_LINE_ACCELERATION_MM_S2 = 400.0
WORKING_ROTATION_RAD_S = math.radians(30.0)
WORKING_ROTATION_RAD_S2 = math.radians(120.0)
T1_SPEED_MM_S = 250.0  # of anything that moves, with a person beside the arm (ISO 10218-1)
T1_SPEED_FRACTION = 0.10  # of the full axis speed


@dataclass(frozen=True)
class MotionLimits:
    """Limits that every planned motion keeps: per joint, and of the tool centre point on a line."""

    speed_rad_s: JointVector
    acceleration_rad_s2: JointVector
    jerk_rad_s3: JointVector
    line_speed_mm_s: float = WORKING_LINE_SPEED_MM_S
    line_acceleration_mm_s2: float = WORKING_LINE_ACCELERATION_MM_S2
    rotation_rad_s: float = WORKING_ROTATION_RAD_S
    rotation_rad_s2: float = WORKING_ROTATION_RAD_S2
    ramp_s: float = ACCELERATION_RAMP_S
    body_speed_mm_s: float = math.inf  # of any body that moves

    def slowed(self, fraction: float) -> MotionLimits:
        """The same with all speeds times `fraction` (0 < fraction <= 1); raises ARM-006 outside that."""
        if not 0.0 < fraction <= 1.0:
            raise MotionInvalid("a speed fraction must be above 0 and at most 1", last=repr(fraction))
        return MotionLimits(
            _times(self.speed_rad_s, fraction),
            self.acceleration_rad_s2,
            self.jerk_rad_s3,
            self.line_speed_mm_s * fraction,
            self.line_acceleration_mm_s2,
            self.rotation_rad_s * fraction,
            self.rotation_rad_s2,
            self.ramp_s,
            self.body_speed_mm_s * fraction,
        )

    def in_mode(self, model: ArmModel, mode: OperationMode) -> MotionLimits:
        """The same in an operating mode: T1 allows 250 mm/s and a tenth of the full axis speed."""
        if mode is not OperationMode.T1:
            return self
        A1, A2, A3, A4, A5, A6 = (
            min(speed, T1_SPEED_FRACTION * full)
            for speed, full in zip(self.speed_rad_s, model.full_speed_rad_s, strict=True)
        )
        return replace(
            self,
            speed_rad_s=(A1, A2, A3, A4, A5, A6),
            line_speed_mm_s=min(self.line_speed_mm_s, T1_SPEED_MM_S),
            body_speed_mm_s=min(self.body_speed_mm_s, T1_SPEED_MM_S),
        )


def working_limits(model: ArmModel, speed_fraction: float = WORKING_SPEED_FRACTION) -> MotionLimits:
    """The limits the driver works with; `speed_fraction` is of the full axis speed."""
    acceleration = _times(model.acceleration_rad_s2, WORKING_ACCELERATION_FRACTION)
    return MotionLimits(
        _times(model.full_speed_rad_s, speed_fraction),
        acceleration,
        _times(acceleration, 1.0 / ACCELERATION_RAMP_S),
    )


def _times(values: Sequence[float], factor: float) -> JointVector:
    A1, A2, A3, A4, A5, A6 = (value * factor for value in values)
    return (A1, A2, A3, A4, A5, A6)
