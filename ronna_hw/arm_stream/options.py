"""Options of an arm that is driven by a stream, as a theatre file states them, and what follows from them."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from math import degrees, radians
from typing import Any

from pydantic import Field

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import (
    LEAST_LINE_SPEED_MM_S,
    RANGE_MARGIN_RAD,
    REDUCED_SPEED_MM_S,
    WORKING_SPEED_FRACTION,
    MotionLimits,
    working_limits,
)
from ronna_hw.arm_stream.records import StreamSettings
from ronna_hw.calibration import Strict

# Safety against a robot link or a program that has stopped (U).
SILENCE_LIMIT_S = 0.25
HEARTBEAT_LIMIT_S = 1.0  # a program busy with other work may be delayed by tens of milliseconds

FOREMOST_PRIORITY = 80  # of SCHED_FIFO: above other programs, below the kernel's own threads
REHEARSAL_LEAD_US = 250  # finished before the sender needs the processor; earlier, others cool the caches
# Safety against a theatre file that asks for a fast arm. Source: `REDUCED_SPEED_MM_S`.
LARGEST_LINE_SPEED_MM_S = REDUCED_SPEED_MM_S  # on straight lines, also with nobody beside the arm

SETTLE_TOLERANCE = "A motion has ended when all axes are within this distance of the target."
SPEED_FRACTION = "Working speed of the axes, as a fraction of full speed."
REHEARSAL_LEAD = "The reply is rehearsed this long before it is due; 0: never."


class StreamOptions(Strict):
    """Options of any streamed arm; a driver adds its own, and narrows or presets some of these."""

    silence_limit_s: float = Field(
        SILENCE_LIMIT_S,
        gt=0.02,
        le=60.0,
        description="Time without anything from the controller's stream after which the arm is in fault.",
    )
    heartbeat_limit_s: float = Field(
        HEARTBEAT_LIMIT_S,
        ge=0.1,
        le=60.0,
        description="The arm is stopped when the program stalls for longer.",
    )
    settle_tolerance_deg: float = Field(ge=0.0001, le=1.0, description=SETTLE_TOLERANCE)
    speed_fraction: float = Field(WORKING_SPEED_FRACTION, gt=0.0, le=1.0, description=SPEED_FRACTION)
    range_margin_deg: float = Field(
        degrees(RANGE_MARGIN_RAD),
        ge=0.0,
        le=30.0,
        description="Margin kept from both ends of each axis's range.",
    )
    line_speed_mm_s: float | None = Field(
        None,
        ge=LEAST_LINE_SPEED_MM_S,
        le=LARGEST_LINE_SPEED_MM_S,
        description="Largest speed on straight lines, instead of the default.",
    )
    real_time_priority: int = Field(
        FOREMOST_PRIORITY, ge=0, le=98, description="SCHED_FIFO priority of the link; 0 requests none."
    )
    rehearsal_lead_us: int = Field(REHEARSAL_LEAD_US, ge=0, le=2000, description=REHEARSAL_LEAD)

    @property
    def patience_s(self) -> float:
        """Patience of the real-time process with this program and with the controller."""
        return max(self.heartbeat_limit_s, self.silence_limit_s)

    def limits(self, arm: Kinematics, cycle_s: float) -> MotionLimits:
        """Return the limits of automatic operation that these options ask for."""
        limits = working_limits(arm, self.speed_fraction)
        return replace(
            limits,
            cycle_s=cycle_s,
            range_margin_rad=radians(self.range_margin_deg),
            line_speed_mm_s=self.line_speed_mm_s or limits.line_speed_mm_s,
        )

    def process_settings(self) -> dict[str, Any]:
        """Return the settings of the real-time process that are options, and the process to serve."""
        names = {field.name for field in fields(StreamSettings)}
        return {"parent_pid": os.getpid(), **self.model_dump(include=names)}
