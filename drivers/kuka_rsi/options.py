"""Options of the driver in the theatre file, and their defaults."""

from __future__ import annotations

from ipaddress import IPv4Address
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from drivers.kuka_rsi.errors import BadOptions
from ronna_hw.arm.limits import WORKING_SPEED_FRACTION
from ronna_hw.arm.model import ArmVariant

SETTLE_TOLERANCE_DEG = 0.0002  # two digits of the wire
SILENCE_LIMIT_S = 0.25
HEARTBEAT_LIMIT_S = 1.0  # a program that does other work may be held up for tens of milliseconds
FOREMOST_PRIORITY = 80  # of SCHED_FIFO: above other programs, below the kernel's own threads
LARGEST_SPEED_FRACTION = 0.125  # above it two prepared steps at once are more than a controller takes


def _ip_address(text: str) -> str:
    return str(IPv4Address(text)) if text else ""


ControllerHost = Annotated[str, AfterValidator(_ip_address)]


class KukaOptions(BaseModel):
    """`[robot.<name>.options]`. Times are the host's; a fraction is of the full axis speed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    variant: ArmVariant = ArmVariant.SIXX
    context: Path | None = None  # another description than our own, in the same form
    cycle_ms: Literal[4, 12] | None = None  # another cycle than the description's
    accept_unverified: bool = False  # of a controller that does not say what it runs
    controller_host: ControllerHost = ""  # who may open a session by RSI; "" for whoever sends
    silence_limit_s: Annotated[float, Field(gt=0.02, le=60.0)] = SILENCE_LIMIT_S
    heartbeat_limit_s: Annotated[float, Field(ge=0.1, le=60.0)] = HEARTBEAT_LIMIT_S
    settle_tolerance_deg: Annotated[float, Field(ge=0.0001, le=1.0)] = SETTLE_TOLERANCE_DEG
    speed_fraction: Annotated[float, Field(gt=0.0, lt=LARGEST_SPEED_FRACTION)] = WORKING_SPEED_FRACTION
    line_speed_mm_s: Annotated[float, Field(gt=0.0, le=250.0)] | None = None
    real_time_priority: Annotated[int, Field(ge=0, le=98)] = FOREMOST_PRIORITY  # 0: do not ask for it


def read_options(device: str, options: dict[str, Any]) -> KukaOptions:
    """Check the options; raises RSI-013 with every mistake."""
    try:
        return KukaOptions.model_validate(options)
    except ValidationError as error:
        mistakes = "; ".join(f"{'.'.join(map(str, m['loc']))}: {m['msg']}" for m in error.errors())
        raise BadOptions(f"{device}: {error.error_count()} wrong options: {mistakes}") from None
