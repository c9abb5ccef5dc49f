"""The controller's own report, as facts of readiness."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.kuka_rsi.eki.controller_state import ControllerState
from ronna_hw.devices.capabilities import MESSAGES, Fact
from ronna_hw.wire.kuka_eki import OperationMode, RsiState

MODES = (OperationMode.EXT, OperationMode.T1)  # modes in which a case can begin; T1 with someone at the arm
MEANINGS = {29002: "RSITimeout: replies came late, were lost or had a wrong Type, and the controller stopped"}
AUTOMATIC = "Set the mode selector to EXT, or to T1 for motions with a person at the pendant."


def standing_facts(state: ControllerState | None) -> tuple[Fact, ...]:
    """Settings made by a person and reported by the controller unsolicited; empty before its first report."""
    return () if state is None else tuple(_standing(state))


def _standing(state: ControllerState) -> Iterator[Fact]:
    """Drives that are off are no objection: `activate` switches them on."""
    yield Fact("operating mode", str(state.mode), state.mode in MODES, AUTOMATIC)
    yield Fact(
        "emergency stop", "pressed" if state.emergency_stop else "released", not state.emergency_stop,
        "Release the emergency stop.",
    )  # fmt: skip
    yield Fact("guard", "open" if state.guard_open else "closed", not state.guard_open, "Close the guard.")
    yield Fact(
        MESSAGES, _message(state.error) if state.error else "none to acknowledge",
        not state.error,
        "Remove its cause; acknowledge it at the pendant or with ronna-procedure acknowledge.",
    )  # fmt: skip
    yield Fact("drives", "on" if state.drives else "off; switched on when the case begins")
    yield _brakes(state)


def _brakes(state: ControllerState) -> Fact:
    """With drives on they may be closed: after a long standstill the controller closes them by itself."""
    if state.open_brakes is None:
        said = "normally released while the drives are on" if state.drives else "the drives are off"
        return Fact("brakes", f"not reported; {said}")
    axes = range(1, len(state.axes_deg) + 1)
    are_open = [f"A{axis}" for axis in axes if state.open_brakes >> (axis - 1) & 1]
    closed = [f"A{axis}" for axis in axes if f"A{axis}" not in are_open]
    if are_open and not state.drives:
        advice = "Let nobody under the arm, and have the brakes tested: it may sink."
        return Fact("brakes", f"open while the drives are off: {' '.join(are_open)}", False, advice)
    if closed and state.moving:
        advice = "Stop the program at the pendant, and have the brakes and their cable tested."
        return Fact("brakes", f"closed while the arm moves: {' '.join(closed)}", False, advice)
    return Fact("brakes", f"closed: {' '.join(closed)}" if closed else "open")


def _message(number: int) -> str:
    meaning = MEANINGS.get(number)
    return (
        f"KSS{number} is not acknowledged ({meaning})" if meaning else f"number {number} is not acknowledged"
    )


def facts_of(state: ControllerState, *, verified: bool) -> Iterator[Fact]:
    """Everything that `activate` checks."""
    yield from _standing(state)
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
