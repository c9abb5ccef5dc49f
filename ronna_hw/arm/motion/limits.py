"""Motion limits per operating mode, well below the arm's capabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ronna_hw.arm.errors import MOTION_INVALID
from ronna_hw.arm.kinematics import JointRanges
from ronna_hw.vectors import JointVector, joint_vector

# Safety against a motion that nobody can follow or stop in time (U).
WORKING_SPEED_FRACTION = 0.12  # below 1/8 of full speed, one lost packet is a small step for the controller
WORKING_ACCELERATION_FRACTION = 0.25  # of the planner's accelerations
RANGE_MARGIN_RAD = math.radians(0.5)  # a controller's software limits may be tighter than the model's
ACCELERATION_RAMP_S = 0.08  # time from none to full acceleration: sets the jerk
WORKING_LINE_SPEED_MM_S = 100.0  # below half of reduced speed
WORKING_LINE_ACCELERATION_MM_S2 = 400.0
WORKING_ROTATION_RAD_S = math.radians(30.0)
WORKING_ROTATION_RAD_S2 = math.radians(120.0)

LEAST_LINE_SPEED_MM_S = 5.0  # of the option: below, it was meant in m/s, or is the speed fraction's job
# Safety against an arm that moves beside a person. Source: ISO 10218-1, reduced speed.
REDUCED_SPEED_MM_S = 250.0  # of anything that moves; the speed of T1
# Safety against an arm that moves beside a person (U).
REDUCED_SPEED_FRACTION = 0.10  # of the full axis speed

ANY_SPEED_MM_S = 1e6  # faster than any arm, and a number that a record can hold


@dataclass(frozen=True)
class MotionLimits:
    """Motion limits in one operating mode: for joints, straight lines and moving bodies.

    Planning, previews, the real-time loop and its monitor use the same record.
    """

    speed_rad_s: JointVector
    acceleration_rad_s2: JointVector
    jerk_rad_s3: JointVector
    line_speed_mm_s: float = WORKING_LINE_SPEED_MM_S
    line_acceleration_mm_s2: float = WORKING_LINE_ACCELERATION_MM_S2
    rotation_rad_s: float = WORKING_ROTATION_RAD_S
    rotation_rad_s2: float = WORKING_ROTATION_RAD_S2
    ramp_s: float = ACCELERATION_RAMP_S
    body_speed_mm_s: float = ANY_SPEED_MM_S  # of everything that moves, at every fraction
    range_margin_rad: float = RANGE_MARGIN_RAD  # kept from both ends of each axis' range
    cycle_s: float = 0.004  # from one set-point to the next

    def ranges(
        self, arm: JointRanges, start_rad: Sequence[float] | None = None
    ) -> tuple[JointVector, JointVector]:
        """Return the lowest and highest permitted joint angles (rad): the axis ranges less the margin.

        An axis that starts closer to an end may stay there or move away.
        """
        margin = self.range_margin_rad
        lower = joint_vector(low + margin for low in arm.lower_rad)
        upper = joint_vector(high - margin for high in arm.upper_rad)
        if start_rad is None:
            return lower, upper
        lows = zip(arm.lower_rad, lower, start_rad, strict=True)
        highs = zip(arm.upper_rad, upper, start_rad, strict=True)
        return (
            joint_vector(max(low, min(least, start)) for low, least, start in lows),
            joint_vector(min(high, max(most, start)) for high, most, start in highs),
        )

    def slowed(self, fraction: float) -> MotionLimits:
        """Scale the planned speeds by `fraction` (0 < fraction <= 1); raises ARM-006 for other values."""
        try:
            is_fraction = 0.0 < fraction <= 1.0
        except TypeError:  # "10%"
            is_fraction = False
        if not is_fraction:
            raise MOTION_INVALID("a speed fraction must be above 0 and at most 1", got=repr(fraction))
        return replace(
            self,
            speed_rad_s=_scale_joints(self.speed_rad_s, fraction),
            line_speed_mm_s=self.line_speed_mm_s * fraction,
            rotation_rad_s=self.rotation_rad_s * fraction,
        )

    def with_reduced_speed(self, arm: JointRanges) -> MotionLimits:
        """Limit speeds to reduced speed and a tenth of full axis speed, with a person near the arm."""
        speeds = zip(self.speed_rad_s, arm.full_speed_rad_s, strict=True)
        return replace(
            self,
            speed_rad_s=joint_vector(min(speed, REDUCED_SPEED_FRACTION * full) for speed, full in speeds),
            line_speed_mm_s=min(self.line_speed_mm_s, REDUCED_SPEED_MM_S),
            body_speed_mm_s=min(self.body_speed_mm_s, REDUCED_SPEED_MM_S),
        )


def working_limits(arm: JointRanges, speed_fraction: float = WORKING_SPEED_FRACTION) -> MotionLimits:
    """Return a driver's default limits; `speed_fraction` is relative to full axis speed."""
    acceleration = _scale_joints(arm.acceleration_rad_s2, WORKING_ACCELERATION_FRACTION)
    return MotionLimits(
        _scale_joints(arm.full_speed_rad_s, speed_fraction),
        acceleration,
        _scale_joints(acceleration, 1.0 / ACCELERATION_RAMP_S),
    )


def _scale_joints(values: Sequence[float], factor: float) -> JointVector:
    return joint_vector(value * factor for value in values)
