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
RANGE_MARGIN_RAD = math.radians(
    0.5
)  # a controller's own end switches may stand a little nearer than a model's
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
    range_margin_rad: float = RANGE_MARGIN_RAD  # kept from both ends of each axis's range

    def ranges(self, model: ArmModel, start_rad: Sequence[float]) -> tuple[JointVector, JointVector]:
        """Lowest and highest angles (rad) of a motion: the axes' ranges less the margin.

        An axis that stands nearer to an end already may stay there or leave.
        """
        margin = self.range_margin_rad
        L1, L2, L3, L4, L5, L6 = (
            max(low, min(low + margin, at)) for low, at in zip(model.lower_rad, start_rad, strict=True)
        )
        U1, U2, U3, U4, U5, U6 = (
            min(high, max(high - margin, at)) for high, at in zip(model.upper_rad, start_rad, strict=True)
        )
        return (L1, L2, L3, L4, L5, L6), (U1, U2, U3, U4, U5, U6)

    def slowed(self, fraction: float) -> MotionLimits:
        """The same with all speeds times `fraction` (0 < fraction <= 1); raises ARM-006 outside that."""
        if not 0.0 < fraction <= 1.0:
            raise MotionInvalid("a speed fraction must be above 0 and at most 1", got=repr(fraction))
        return replace(
            self,
            speed_rad_s=_times(self.speed_rad_s, fraction),
            line_speed_mm_s=self.line_speed_mm_s * fraction,
            rotation_rad_s=self.rotation_rad_s * fraction,
            body_speed_mm_s=self.body_speed_mm_s * fraction,
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
