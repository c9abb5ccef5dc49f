"""Arm options in the theatre file, and what follows from them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from drivers.theatre_options import parse_options
from drivers.universal_robots.errors import BAD_OPTIONS
from drivers.universal_robots.generations import GENERATIONS
from drivers.universal_robots.realtime.settings import LinkSettings
from ronna_hw.arm.catalogue import UNIVERSAL_ROBOTS
from ronna_hw.arm.motion.limits import WORKING_SPEED_FRACTION
from ronna_hw.arm.name_field import arm_of
from ronna_hw.arm.universal_robots import UR5E, universal_robot
from ronna_hw.arm_stream.options import (
    REHEARSAL_LEAD,
    REHEARSAL_LEAD_US,
    SETTLE_TOLERANCE,
    SPEED_FRACTION,
    StreamOptions,
)
from ronna_hw.config import Role
from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots import ScriptSettings

SETTLE_TOLERANCE_DEG = 0.0008  # of servoj at rest (U); a tenth of what 0.1 mm of repeatability means
# Safety against a late or missing set-point (U).
LARGEST_SPEED_FRACTION = 0.25  # a late set-point makes one step of twice that, half of what the script takes
STARVE_LIMIT_S = 0.02  # without a new set-point, until the script stops the arm

LEAST_STARVED_CYCLES = 3  # one late set-point is no loss of the link
# Safety against a set-point that is a jump, and a stop that takes long (U).
LARGEST_STEP_SHARE = 0.5  # of a joint's full speed, between two set-points
STOP_DECELERATION_RAD_S2 = 8.0  # of stopj: twice the vendor's default, to rest in 50 ms at working speed (U)

FORCE_FILTER_S = 0.02  # a few cycles of CB3: halves the noise of its estimate
# Safety against a tool whose mass the controller does not know.
FORCE_AT_REST_N = 15.0  # above the bias of CB3 on three axes (U), below a tool whose mass was not set

LOOKAHEAD_S = 0.03  # the least: the arm follows within 34 ms
GAIN = 1000.0
TOOL_INPUTS = tuple(wire.TOOL_INPUTS)
LAST_DIGITAL_INPUT = 17

EXAMPLE_HOST = "192.168.56.101"  # of the vendor's own examples
ROLES = {  # the controller has fixed these ports
    "rtde": Role(f"tcp://{EXAMPLE_HOST}:{wire.RTDE_PORT}", "Set-points and measured joints, every cycle."),
    "dashboard": Role(
        f"tcp://{EXAMPLE_HOST}:{wire.DASHBOARD_PORT}", "Identity, power, brakes, modes and protective stops."
    ),
    "primary": Role(
        f"tcp://{EXAMPLE_HOST}:{wire.PRIMARY_PORT}",
        "Factory calibration, state while nothing streams, messages; takes our script.",
    ),
}

DigitalInput = Annotated[int, Field(ge=0, le=LAST_DIGITAL_INPUT)]


class UrOptions(StreamOptions):
    """Arm options: table `[robot.<name>.options]`, with host times and fractions of full joint speed."""

    model: Annotated[str, arm_of(UNIVERSAL_ROBOTS)] = Field(
        UR5E, description="Model of the arm: ur5, ur5e, ur3e, ur10e or ur16e; the controller must agree."
    )
    serial: str = Field("", description="Expected serial number of the arm; empty: any.")
    calibration: str = Field(
        "",
        description="Fingerprint of the factory calibration that this theatre was measured with, as the "
        "doctor reports it; another arm is refused. Empty: any.",
    )
    factory_calibration: bool = Field(
        True, description="Compute with the factory calibration of this arm, not with its nominal dimensions."
    )
    settle_tolerance_deg: float = Field(SETTLE_TOLERANCE_DEG, ge=0.0001, le=1.0, description=SETTLE_TOLERANCE)
    speed_fraction: float = Field(
        WORKING_SPEED_FRACTION, gt=0.0, le=LARGEST_SPEED_FRACTION, description=SPEED_FRACTION
    )
    tool_inputs: tuple[DigitalInput, ...] = Field(
        TOOL_INPUTS,
        min_length=1,
        max_length=8,
        description="Digital inputs that carry the number of the mounted tool, least significant bit first: "
        "0 to 7 standard, 8 to 15 configurable, 16 and 17 on the tool flange.",
    )
    payload_kg: float | None = Field(
        None,
        ge=0.0,
        le=5.0,
        description="Mass on the flange, set by our script; default: what the installation sets.",
    )
    force_filter_s: float = Field(
        FORCE_FILTER_S,
        ge=0.002,
        le=0.5,
        description="Time constant by which the estimated force on the tool is smoothed.",
    )
    force_at_rest_N: float = Field(
        FORCE_AT_REST_N,
        gt=0.0,
        le=50.0,
        description="Estimated force on the free tool above which no motion with a force limit begins.",
    )
    force_error_N: float = Field(
        0.0,
        ge=0.0,
        le=10.0,
        description="Two standard errors of a change of the estimated force, as measured on this arm: a "
        "limit is kept by as much. 0: none is known.",
    )
    starve_limit_s: float = Field(
        STARVE_LIMIT_S,
        ge=0.01,
        le=0.5,
        description="Time without a new set-point after which the script stops the arm by itself.",
    )
    lookahead_s: float = Field(
        LOOKAHEAD_S, ge=0.03, le=0.2, description="Look-ahead of servoj: longer is smoother and later."
    )
    gain: float = Field(GAIN, ge=100.0, le=2000.0, description="Gain of servoj.")
    stop_deceleration_rad_s2: float = Field(
        STOP_DECELERATION_RAD_S2,
        gt=0.0,
        le=40.0,
        description="Deceleration with which the script stops the arm when no set-point comes.",
    )
    rehearsal_lead_us: int = Field(REHEARSAL_LEAD_US, ge=0, le=1500, description=REHEARSAL_LEAD)

    @property
    def cycle_s(self) -> float:
        """Cycle of the controller."""
        return GENERATIONS[self.model].cycle_s


def read_options(device: str, options: dict[str, Any]) -> UrOptions:
    """Parse the arm options; raises URD-001 listing every mistake."""
    return parse_options(UrOptions, options, f"{device}: options", BAD_OPTIONS)


def script_settings(options: UrOptions) -> ScriptSettings:
    """Return the settings of our script."""
    full_speed_rad_s = min(universal_robot(options.model).full_speed_rad_s)
    return ScriptSettings(
        CYCLE_S=options.cycle_s,
        STARVED_CYCLES=max(round(options.starve_limit_s / options.cycle_s), LEAST_STARVED_CYCLES),
        LARGEST_STEP_RAD=LARGEST_STEP_SHARE * full_speed_rad_s * options.cycle_s,
        STOP_DECELERATION_RAD_S2=options.stop_deceleration_rad_s2,
        LOOKAHEAD_S=options.lookahead_s,
        GAIN=options.gain,
    )


def link_settings(options: UrOptions, handover_fd: int, calibration: tuple[float, ...] = ()) -> LinkSettings:
    """Return the settings of a real-time process that this one starts."""
    return LinkSettings(
        handover_fd=handover_fd,
        model=options.model,
        cycle_s=options.cycle_s,
        starved_cycles=script_settings(options).STARVED_CYCLES,
        calibration=calibration,
        **options.process_settings(),
    )
