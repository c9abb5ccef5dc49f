"""The controller's `State`, and whether it matches the driver's configuration."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from xml.etree import ElementTree

from drivers.kuka_rsi.errors import BadEkiTelegram, ControllerNotReady, WrongController
from ronna_hw.arm.kr6_r900 import ArmVariant
from ronna_hw.devices.readings import JointVector
from ronna_hw.wire.kuka_context import RsiContext, context_hash
from ronna_hw.wire.kuka_eki import (
    AXIS,
    AXIS_ATTRIBUTES,
    STATE,
    OperationMode,
    Reference,
    RsiState,
    StateAttribute,
)

IN_A_CONTEXT = "a context of the same telegrams, Type, wiring, limits, HOLDON, Timeout and Precision"


@dataclass(frozen=True)
class ControllerState:
    """One `State`. The last seven are None if the controller does not report them."""

    received_s: float  # host monotonic
    mode: OperationMode
    drives: bool
    emergency_stop: bool
    guard_open: bool
    moving: bool
    error: int
    rsi: RsiState
    tool: int
    axes_deg: JointVector
    reference: str | None
    holdon: bool | None
    cycle_ms: int | None
    context_hash: str | None
    variant: str | None
    serial: str | None
    open_brakes: int | None  # one bit for each axis


def read_state(element: ElementTree.Element, received_s: float) -> ControllerState:
    """Read a `State` element; raises EKI-004 if a required value is missing or not a number."""
    get = element.get
    axis = element.find(AXIS)
    if element.tag != STATE or axis is None:
        raise BadEkiTelegram("a State without axes", wire=ElementTree.tostring(element))
    holdon, cycle = get(StateAttribute.HOLDON), get(StateAttribute.CYCLE)
    serial, brakes = get(StateAttribute.SERIAL), get(StateAttribute.BRAKES)
    try:
        A1, A2, A3, A4, A5, A6 = (_number(axis.attrib[name]) for name in AXIS_ATTRIBUTES)
        return ControllerState(
            received_s=received_s,
            mode=OperationMode(element.attrib[StateAttribute.MODE]),
            drives=_bool(element, StateAttribute.DRIVES),
            emergency_stop=_bool(element, StateAttribute.ESTOP),
            guard_open=_bool(element, StateAttribute.GUARD),
            moving=_bool(element, StateAttribute.MOVING),
            error=int(element.attrib[StateAttribute.ERROR]),
            rsi=RsiState(int(element.attrib[StateAttribute.RSI])),
            tool=int(element.attrib[StateAttribute.TOOL]),
            axes_deg=(A1, A2, A3, A4, A5, A6),
            reference=get(StateAttribute.REFERENCE),
            holdon=None if holdon is None else bool(int(holdon)),
            cycle_ms=None if cycle is None else int(cycle),
            context_hash=get(StateAttribute.CONTEXT_HASH),
            variant=get(StateAttribute.VARIANT),
            serial=None if serial in (None, "", "0") else serial,
            open_brakes=None if not brakes else int(brakes),
        )
    except (KeyError, ValueError) as error:
        raise BadEkiTelegram(
            f"a State that cannot be read: {error}", wire=ElementTree.tostring(element)
        ) from error


def require_ours(state: ControllerState, context: RsiContext, variant: ArmVariant) -> tuple[str, ...]:
    """What the controller does not report; raises EKI-005 listing every reported value that differs."""
    reference = Reference.ABSOLUTE if context.program.corrections == "absolute" else Reference.RELATIVE
    facts = (
        ("cycle in ms", context.program.cycle_ms, state.cycle_ms),
        ("corrections", reference.value, state.reference),
        ("HOLDON", True, state.holdon),
        ("context hash", context_hash(context), state.context_hash),
        ("arm", variant.value, state.variant),
    )
    wrong = [
        f"{name} is {said}, not {expected}"
        for name, expected, said in facts
        if said is not None and said != expected
    ]
    if wrong:
        raise WrongController(
            "the controller is not set up for this driver: " + "; ".join(wrong),
            expected=IN_A_CONTEXT if state.context_hash not in (None, context_hash(context)) else None,
        )
    return tuple(name for name, _, said in facts if said is None)


def require_ready(
    state: ControllerState, *, drives: bool, modes: tuple[OperationMode, ...] = (OperationMode.EXT,)
) -> None:
    """Raise EKI-007 listing everything that forbids motion; `drives`: they must already be on."""
    unmet = what_forbids_motion(state, drives=drives, modes=modes)
    if unmet:
        raise ControllerNotReady("the controller is not ready: " + "; ".join(unmet))


def what_forbids_motion(
    state: ControllerState, *, drives: bool, modes: tuple[OperationMode, ...]
) -> list[str]:
    """All of them, in words."""
    unmet = []
    if state.mode not in modes:
        unmet.append(f"operating mode is {state.mode}, not {' or '.join(modes)}")
    if state.emergency_stop:
        unmet.append("emergency stop is active")
    if state.guard_open:
        unmet.append("the guard is open")
    if state.error:
        unmet.append(f"message {state.error} is not acknowledged")
    if drives and not state.drives:
        unmet.append("drives are off")
    return unmet


def _number(text: str) -> float:
    """Rejects NaN, for which every comparison would be false."""
    value = float(text)
    if not isfinite(value):
        raise ValueError(f"{text!r} is not a number")
    return value


def _bool(element: ElementTree.Element, attribute: StateAttribute) -> bool:
    return bool(_number(element.attrib[attribute]))
