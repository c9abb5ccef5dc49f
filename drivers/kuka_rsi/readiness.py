"""Readiness of a KUKA controller, by what it reports."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.kuka_rsi.eki.telegrams import ControllerState
from ronna_hw.devices.capabilities import EMERGENCY_STOP, MESSAGES, Fact
from ronna_hw.wire.kuka_eki import OperationMode, RsiState

MODES = (OperationMode.EXT, OperationMode.T1)  # modes in which a case can begin; T1 with someone at the arm
MEANINGS = {
    29002: "KSS29002 is not acknowledged (RSITimeout: replies came late, were lost or had a wrong Type, and "
    "the controller stopped)"
}
MODE_ADVICE = "Set the mode selector to EXT, or to T1 for motions with a person at the pendant."


def controller_facts(state: ControllerState) -> Iterator[Fact]:
    """Yield the controller's status. Drives that are off are no objection: `activate` switches them on."""
    yield Fact("operating mode", str(state.mode), state.mode in MODES, MODE_ADVICE)
    yield Fact(
        EMERGENCY_STOP, "pressed" if state.emergency_stop else "released", not state.emergency_stop,
        "Release the emergency stop.",
    )  # fmt: skip
    yield Fact("guard", "open" if state.guard_open else "closed", not state.guard_open, "Close the guard.")
    known = MEANINGS.get(state.error, f"number {state.error} is not acknowledged")
    yield Fact(
        MESSAGES, known if state.error else "none to acknowledge", not state.error,
        "Remove its cause; acknowledge it at the pendant or with ronna-procedure acknowledge.",
    )  # fmt: skip
    yield Fact("drives", "on" if state.drives else "off; switched on when the case begins")
    yield _brakes_fact(state)


def _brakes_fact(state: ControllerState) -> Fact:
    """Report the brake status; brakes may be closed even with drives on."""
    if state.open_brakes is None:
        drives_text = "normally released while the drives are on" if state.drives else "the drives are off"
        return Fact("brakes", f"not reported; {drives_text}")
    axes = range(1, len(state.axes_deg) + 1)
    open_axes = [f"A{axis}" for axis in axes if state.open_brakes >> (axis - 1) & 1]
    closed_axes = [f"A{axis}" for axis in axes if f"A{axis}" not in open_axes]
    if open_axes and not state.drives:
        advice = "Let nobody under the arm, and have the brakes tested: it may sink."
        return Fact("brakes", f"open while the drives are off: {' '.join(open_axes)}", False, advice)
    if closed_axes and state.moving:
        advice = "Stop the program at the pendant, and have the brakes and their cable tested."
        return Fact("brakes", f"closed while the arm moves: {' '.join(closed_axes)}", False, advice)
    return Fact("brakes", f"closed: {' '.join(closed_axes)}" if closed_axes else "open")


def readiness_facts(state: ControllerState, *, verified: bool) -> Iterator[Fact]:
    """Yield every condition that `activate` checks."""
    yield from controller_facts(state)
    yield Fact(
        "RSI program", state.rsi.name, state.rsi is RsiState.IDLE,
        "A message ended it: remove its cause and acknowledge it." if state.rsi is RsiState.FAULT
        else "Another client is streaming: stop it, or reset the program at the pendant.",
    )  # fmt: skip
    yield Fact(
        "at rest", "moving" if state.moving else "yes", not state.moving, "Wait until the arm is at rest."
    )
    yield Fact(
        "context",
        "matches" if verified else "not reported; verified at start by a micro-move with a person present",
    )
