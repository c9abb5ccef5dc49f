"""Options of the driver in the theatre file, and their defaults."""

from __future__ import annotations

import json
from ipaddress import IPv4Address
from math import degrees
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError

from drivers.kuka_rsi.errors import BadOptions
from ronna_hw.arm.kr6_r900 import ArmVariant
from ronna_hw.arm.motion.limits import RANGE_MARGIN_RAD, WORKING_SPEED_FRACTION
from ronna_hw.calibration import Strict
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import counted

SETTLE_TOLERANCE_DEG = 0.0002  # two digits of the wire
SILENCE_LIMIT_S = 0.25
HEARTBEAT_LIMIT_S = 1.0  # a program busy with other work may be delayed by tens of milliseconds
FOREMOST_PRIORITY = 80  # of SCHED_FIFO: above other programs, below the kernel's own threads
REHEARSAL_LEAD_US = 500  # finished before the sender needs the processor, with caches still warm
LARGEST_SPEED_FRACTION = 0.125  # above this, two prepared steps at once exceed what a controller accepts


def _ip_address(text: str) -> str:
    return str(IPv4Address(text)) if text else ""


ControllerHost = Annotated[str, AfterValidator(_ip_address)]


class KukaOptions(Strict):
    """`[robot.<name>.options]`. Times are the host's; a fraction is of the full axis speed."""

    variant: ArmVariant = Field(ArmVariant.SIXX, description="Variant of the arm, as on its name plate.")
    context: Path | None = Field(
        None, description="Description of another RSI context, in the format of the built-in one."
    )
    cycle_ms: Literal[4, 12] | None = Field(None, description="Cycle, if it differs from the description.")
    accept_unverified: bool = Field(
        False,
        description="Connect to a controller that does not report its context; a micro-move verifies it.",
    )
    controller_host: ControllerHost = Field(
        "", description="The only address that may open the RSI stream; empty: the first sender."
    )
    silence_limit_s: float = Field(
        SILENCE_LIMIT_S,
        gt=0.02,
        le=60.0,
        description="Time without a telegram after which the arm is in fault.",
    )
    heartbeat_limit_s: float = Field(
        HEARTBEAT_LIMIT_S,
        ge=0.1,
        le=60.0,
        description="The arm is stopped when the program stalls for longer.",
    )
    settle_tolerance_deg: float = Field(
        SETTLE_TOLERANCE_DEG,
        ge=0.0001,
        le=1.0,
        description="A motion has ended when all axes are within this distance of the target.",
    )
    speed_fraction: float = Field(
        WORKING_SPEED_FRACTION,
        gt=0.0,
        lt=LARGEST_SPEED_FRACTION,
        description="Working speed of the axes, as a fraction of full speed.",
    )
    range_margin_deg: float = Field(
        degrees(RANGE_MARGIN_RAD),
        ge=0.0,
        le=30.0,
        description="Margin kept from both ends of each axis's range.",
    )
    line_speed_mm_s: float | None = Field(
        None, gt=0.0, le=250.0, description="Largest speed on straight lines, instead of the default."
    )
    real_time_priority: int = Field(
        FOREMOST_PRIORITY, ge=0, le=98, description="SCHED_FIFO priority of the link; 0 requests none."
    )
    rehearsal_lead_us: int = Field(
        REHEARSAL_LEAD_US,
        ge=0,
        le=2000,
        description="The reply is rehearsed this long before its telegram is due; 0: never.",
    )


def read_options(device: str, options: dict[str, Any]) -> KukaOptions:
    """Check the options; raises RSI-013 with every mistake."""
    try:
        # via JSON: strict types, but text is accepted for a path and for a variant
        return KukaOptions.model_validate_json(json.dumps(options, default=str))
    except ValidationError as error:
        mistakes = describe_mistakes(error, KukaOptions)
        raise BadOptions(
            f"{device}: options have {counted(len(mistakes), 'mistake')}: " + "; ".join(mistakes)
        ) from None
