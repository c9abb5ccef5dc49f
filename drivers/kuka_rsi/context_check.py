"""Whether the driver may move an arm with an RSI context. Checked before anything is opened."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.kuka_rsi.errors import ContextUnusable
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES
from ronna_hw.wire.kuka_context import SOFTWARE_END_SWITCHES, RsiContext, load_context

LEAST_PRECISION = 3  # decimals: with fewer the arm never settles within its tolerance
NEEDED_KEYWORDS = ("DEF_AIPos", "DEF_Delay")


def usable_context(device: str, options: KukaOptions) -> RsiContext:
    """The context from the options; raises WIR-001 for a broken file, RSI-017 listing every objection."""
    context = load_context(options.context)
    if options.cycle_ms is not None:
        program = context.program.model_copy(update={"cycle_ms": options.cycle_ms})
        context = context.model_copy(update={"program": program})
    reasons = list(reasons_against(context))
    if context.program.variant != options.variant.value:
        reasons.append(f"its program is for {context.program.variant}, option variant is {options.variant}")
    if reasons:
        source = options.context or "our own"
        raise ContextUnusable(f"{device}: the RSI context ({source}) cannot be used: " + "; ".join(reasons))
    return context


def reasons_against(context: RsiContext) -> Iterator[str]:
    """Everything that makes a context unsafe, or that it fails to report."""
    holdon = {element.indx: element.holdon for element in context.receive}
    axes = [w for w in context.wiring if w.object == "AXISCORR"]
    stops = [w for w in context.wiring if w.object == "STOP"]
    if context.program.corrections != "absolute":
        runaway = any(holdon[w.indx] for w in axes)
        yield "corrections are relative" + (
            " with HOLDON 1: a lost reply would keep the arm moving" if runaway else ", not absolute"
        )
    elif any(not holdon[w.indx] for w in axes):
        yield "corrections have HOLDON 0: a lost reply would jump back to the start pose"
    unwired = sorted({*AXIS_NAMES} - {w.input for w in axes})
    if unwired:
        yield f"AXISCORR is not wired for {' '.join(unwired)}"
    if any(w.object == "POSCORR" for w in context.wiring):
        yield "POSCORR is wired as well: two corrections would add up"
    if not stops or context.stop is None or context.stop.mode != "ExitMoveCorr":
        yield "no STOP object of mode ExitMoveCorr is wired: this driver could not end the program"
    elif any(holdon[w.indx] for w in stops):
        yield "STOP has HOLDON 1: it would stay set"
    yield from _limits(context)
    said = {element.tag for element in context.send}
    for keyword in NEEDED_KEYWORDS:
        if keyword not in said:
            yield f"{keyword} is not sent"
    if context.ethernet.only_send:
        yield "ONLYSEND is TRUE: replies would be ignored"
    if context.ethernet.precision < LEAST_PRECISION:
        yield f"Precision is {context.ethernet.precision}, not at least {LEAST_PRECISION}"


def _limits(context: RsiContext) -> Iterator[str]:
    """The driver's own monitor checks up to the end switches: the controller must neither clamp nor trip
    before, and what AXISCORR passes must not trip AXISCORRMON.
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
