"""Arm options in the theatre file, and loading of the RSI context."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import IPv4Address
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from drivers.kuka_rsi.errors import BAD_OPTIONS, CONTEXT_UNUSABLE
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES
from drivers.theatre_options import parse_options
from ronna_hw.arm.catalogue import KUKA
from ronna_hw.arm.kr6_r900 import SIXX
from ronna_hw.arm.motion.limits import WORKING_SPEED_FRACTION
from ronna_hw.arm.name_field import arm_of
from ronna_hw.arm_stream.options import SETTLE_TOLERANCE, SPEED_FRACTION, StreamOptions
from ronna_hw.config import Role
from ronna_hw.wire.kuka_context import SOFTWARE_END_SWITCHES, RsiContext, load_context
from ronna_hw.wire.kuka_eki import PROJECT_PORT

SETTLE_TOLERANCE_DEG = 0.0002  # two digits of the wire
# Safety against a lost telegram that becomes a jump (U).
LARGEST_SPEED_FRACTION = 0.125  # above this, two prepared steps at once exceed what a controller accepts

LEAST_PRECISION = 3  # decimals: with fewer the arm never settles within its tolerance
# Of a six-axis sensor: noise of a tenth of a newton is left of that of its samples.
FORCE_FILTER_S = 0.02
FORCE_AT_REST_N = 15.0  # above the bias of a sensor with the holder's weight, below a tool that leans (U)
FORCE_ERROR_N = 1.0  # crosstalk and gain of a sensor for 100 N at 25 N, and drift within two minutes (U)
NEEDED_KEYWORDS = ("DEF_AIPos", "DEF_Delay")
EXAMPLE_CONTROLLER = f"tcp://172.31.1.147:{PROJECT_PORT}"  # default address of a KR C4
ROLES = {
    "rsi": Role("udp://192.168.10.20:59152", "Address of this computer to which the controller streams."),
    "eki_project": Role(EXAMPLE_CONTROLLER, "The controller's EKI server of the project's files."),
}

ControllerHost = Annotated[str, AfterValidator(lambda text: str(IPv4Address(text)) if text else "")]


class KukaOptions(StreamOptions):
    """Arm options: table `[robot.<name>.options]`, with host times and fractions of full axis speed."""

    variant: Annotated[str, arm_of(KUKA)] = Field(
        SIXX, description="Variant of the arm, as on its name plate."
    )
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
    force_sensor: bool = Field(
        False,
        description="A six-axis force sensor on the flange is wired to the controller, whose telegrams have "
        "its signals as FT: forces in N along the axes of the flange.",
    )
    force_filter_s: float = Field(
        FORCE_FILTER_S, gt=0.0, le=0.5, description="Time constant by which its forces are smoothed."
    )
    force_at_rest_N: float = Field(
        FORCE_AT_REST_N,
        gt=0.0,
        le=50.0,
        description="Force on the free tool above which no motion with a force limit begins.",
    )
    force_error_N: float = Field(
        FORCE_ERROR_N,
        ge=0.0,
        le=10.0,
        description="Two standard errors of a change of the force, by its certificate: a limit is kept by "
        "as much.",
    )
    settle_tolerance_deg: float = Field(SETTLE_TOLERANCE_DEG, ge=0.0001, le=1.0, description=SETTLE_TOLERANCE)
    speed_fraction: float = Field(
        WORKING_SPEED_FRACTION, gt=0.0, lt=LARGEST_SPEED_FRACTION, description=SPEED_FRACTION
    )

    def process_settings(self) -> dict[str, Any]:
        """Return the settings of the real-time process; without a force sensor it watches no force."""
        unwatched = {} if self.force_sensor else {"force_filter_s": 0.0}
        return super().process_settings() | unwatched


def read_options(device: str, options: dict[str, Any]) -> KukaOptions:
    """Parse the arm options; raises RSI-013 listing every mistake."""
    return parse_options(KukaOptions, options, f"{device}: options", BAD_OPTIONS)


def load_usable_context(device: str, options: KukaOptions) -> RsiContext:
    """Load the configured RSI context; raises WIR-001 for an invalid file, RSI-017 listing all objections."""
    context = load_context(options.context)
    if options.cycle_ms is not None:
        program = context.program.model_copy(update={"cycle_ms": options.cycle_ms})
        context = context.model_copy(update={"program": program})
    reasons = list(find_objections(context))
    if context.program.variant != options.variant:
        reasons.append(f"its program is for {context.program.variant}, option variant is {options.variant}")
    if reasons:
        source = options.context or "our own"
        raise CONTEXT_UNUSABLE(f"{device}: the RSI context ({source}) cannot be used: " + "; ".join(reasons))
    return context


def find_objections(context: RsiContext) -> Iterator[str]:
    """List all reasons why a context is unsafe or insufficient for this driver."""
    holdon = {element.indx: element.holdon for element in context.receive}
    axes = [w for w in context.wiring if w.object == "AXISCORR"]
    stop_count = [w for w in context.wiring if w.object == "STOP"]
    if context.program.corrections != "absolute":
        is_runaway = any(holdon[w.indx] for w in axes)
        yield "corrections are relative" + (
            " with HOLDON 1: a lost reply would keep the arm moving" if is_runaway else ", not absolute"
        )
    elif any(not holdon[w.indx] for w in axes):
        yield "corrections have HOLDON 0: a lost reply would jump back to the start pose"
    if unwired := sorted({*AXIS_NAMES} - {w.input for w in axes}):
        yield f"AXISCORR is not wired for {' '.join(unwired)}"
    if any(w.object == "POSCORR" for w in context.wiring):
        yield "POSCORR is wired as well: two corrections would add up"
    if not stop_count or context.stop is None or context.stop.mode != "ExitMoveCorr":
        yield "no STOP object of mode ExitMoveCorr is wired: this driver could not end the program"
    elif any(holdon[w.indx] for w in stop_count):
        yield "STOP has HOLDON 1: it would stay set"
    yield from _find_limit_objections(context)
    sent_tags = {element.tag for element in context.send}
    for keyword in NEEDED_KEYWORDS:
        if keyword not in sent_tags:
            yield f"{keyword} is not sent"
    if context.ethernet.only_send:
        yield "ONLYSEND is TRUE: replies would be ignored"
    if context.ethernet.precision < LEAST_PRECISION:
        yield f"Precision is {context.ethernet.precision}, not at least {LEAST_PRECISION}"


def _find_limit_objections(context: RsiContext) -> Iterator[str]:
    """List limits by which the controller would clamp or trip before the driver's own monitor.

    That monitor allows motion up to the end switches; values that AXISCORR passes must not trip AXISCORRMON.
    """
    correction, monitor = context.axis_correction, context.axis_monitor
    if correction is None:
        yield "limits of AXISCORR are missing: its default of 5 deg would clamp silently"
    if monitor is None:
        yield "limits of AXISCORRMON are missing: its default of 6 deg would end every larger motion"
    if correction is None or monitor is None:
        return
    if correction.limits != SOFTWARE_END_SWITCHES:
        yield "limits of AXISCORR are not the software end switches: it would clamp silently"
    if monitor.limits == SOFTWARE_END_SWITCHES:
        return
    spans = zip(correction.lower_deg, correction.upper_deg, monitor.max_deg, strict=True)
    if correction.limits == SOFTWARE_END_SWITCHES or any(max(-low, high) > most for low, high, most in spans):
        yield "limits of AXISCORR are wider than those of AXISCORRMON: reaching them would end the program"
