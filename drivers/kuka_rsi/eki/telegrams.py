"""EKI telegrams: splitting the byte stream and parsing the controller's `State`.

EKI has no framing: a telegram ends with its root element. A truncated one is detected by the first bytes of
the next. Otherwise they would count as part of it, and nothing would be read until the buffer is full.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import ClassVar, NoReturn
from xml.etree import ElementTree

from drivers.kuka_rsi.errors import BAD_EKI_TELEGRAM, CONTROLLER_NOT_READY, WRONG_CONTROLLER
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.pose import radians6
from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.devices.capabilities import EMERGENCY_STOP
from ronna_hw.vectors import JointVector
from ronna_hw.wire.kuka_context import RsiContext, context_hash
from ronna_hw.wire.kuka_eki import (
    ACK,
    AXIS,
    AXIS_ATTRIBUTES,
    STATE,
    OperationMode,
    Reference,
    RsiState,
    StateAttribute,
)

LONGEST_TELEGRAM = 16384  # the default BUFFSIZE of an EKI channel
ROOTS = (STATE.encode(), ACK.encode())  # root tags with which a controller begins a telegram
IN_A_CONTEXT = "a context of the same telegrams, Type, wiring, limits, HOLDON, Timeout and Precision"
_MARK = re.compile(rb"[<>\"']")
_NAME = re.compile(rb"[^\s/>]*")


class TelegramScanner:
    """Incremental splitter of a byte stream into complete root elements.

    Padding and anything else before a root is skipped. A document type declaration is refused.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._root_start = -1  # of the root, -1 between telegrams
        self._scanned = 0  # scanned so far
        self._depth = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield complete telegrams in order; raises EKI-004 if one is malformed, truncated or too long."""
        self._buffer += data
        while (tag := self._next_tag()) is not None:
            start, end = tag
            inner = bytes(self._buffer[start + 1 : end])
            if inner[:1] == b"!":
                raise BAD_EKI_TELEGRAM("an XML declaration inside a telegram", wire=bytes(self._buffer))
            if inner[:1] == b"?":
                continue
            if self._root_start < 0:
                if inner[:1] == b"/":
                    continue  # the end of something whose beginning was lost
                self._root_start, self._depth = start, 0
            elif (name := _NAME.match(inner)) and name[0] in ROOTS:
                self._refuse_truncated()
            if inner[:1] == b"/":
                self._depth -= 1
            elif inner[-1:] != b"/":
                self._depth += 1
            if self._depth == 0:
                yield bytes(self._buffer[self._root_start : end + 1])
                del self._buffer[: end + 1]
                self._root_start, self._scanned = -1, 0
        if len(self._buffer) > LONGEST_TELEGRAM:
            raise BAD_EKI_TELEGRAM(
                "a telegram without end tag", limit=f"{LONGEST_TELEGRAM} bytes", wire=bytes(self._buffer)
            )

    def _next_tag(self) -> tuple[int, int] | None:
        """Find the next complete tag, respecting quotes; returns the positions of "<" and ">"."""
        buffer = self._buffer
        if (start := buffer.find(b"<", self._scanned)) < 0:
            if self._root_start < 0:
                buffer.clear()
            self._scanned = len(buffer)
            return None
        if self._root_start < 0 and start > 0:
            del buffer[:start]
            start = 0
        quote = b""
        for mark in _MARK.finditer(buffer, start + 1):
            if (found := mark[0]) == b"<":
                self._refuse_truncated()  # no tag contains one, not even in quotes
            if quote:
                quote = b"" if found == quote else quote
            elif found != b">":
                quote = found
            else:
                self._scanned = mark.end()
                return start, mark.start()
        self._scanned = start
        return None

    def _refuse_truncated(self) -> NoReturn:
        raise BAD_EKI_TELEGRAM("a telegram is truncated", expected="its end", wire=bytes(self._buffer))


def parse_telegram(telegram: bytes) -> ElementTree.Element:
    """Parse a telegram as XML; raises EKI-004 if it is not well-formed."""
    try:
        return parse_xml(telegram, LONGEST_TELEGRAM)
    except InputRefused as error:
        raise BAD_EKI_TELEGRAM(f"not a well-formed telegram: {error.summary}", wire=telegram) from error


@dataclass(frozen=True)
class ControllerState:
    """Decoded controller `State`; the last seven fields are None if not reported."""

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
    reference: str | None = None
    holdon: bool | None = None
    cycle_ms: int | None = None
    context_hash: str | None = None
    variant: str | None = None
    serial: str | None = None
    open_brakes: int | None = None  # one bit for each axis
    device_clock: ClassVar[int] = 0  # EKI has none

    @property
    def joints_rad(self) -> JointVector:
        """Measured joint angles."""
        return radians6(*self.axes_deg)


def read_state(element: ElementTree.Element, received_s: float) -> ControllerState:
    """Decode a `State` element; raises EKI-004 if a required value is missing or invalid."""
    get = element.get
    axis = element.find(AXIS)
    if element.tag != STATE or axis is None:
        raise BAD_EKI_TELEGRAM("a State without axes", wire=ElementTree.tostring(element))
    holdon, cycle = get(StateAttribute.HOLDON), get(StateAttribute.CYCLE)
    serial, brakes = get(StateAttribute.SERIAL), get(StateAttribute.BRAKES)
    try:
        return ControllerState(
            received_s=received_s,
            mode=OperationMode(element.attrib[StateAttribute.MODE]),
            drives=_parse_flag(element, StateAttribute.DRIVES),
            emergency_stop=_parse_flag(element, StateAttribute.ESTOP),
            guard_open=_parse_flag(element, StateAttribute.GUARD),
            moving=_parse_flag(element, StateAttribute.MOVING),
            error=int(element.attrib[StateAttribute.ERROR]),
            rsi=RsiState(int(element.attrib[StateAttribute.RSI])),
            tool=int(element.attrib[StateAttribute.TOOL]),
            axes_deg=tuple(_parse_number(axis.attrib[name]) for name in AXIS_ATTRIBUTES),
            reference=get(StateAttribute.REFERENCE),
            holdon=None if holdon is None else bool(int(holdon)),
            cycle_ms=None if cycle is None else int(cycle),
            context_hash=get(StateAttribute.CONTEXT_HASH),
            variant=get(StateAttribute.VARIANT),
            serial=None if serial in (None, "", "0") else serial,
            open_brakes=None if not brakes else int(brakes),
        )
    except (KeyError, ValueError) as error:
        what = f"a State that cannot be read: {error}"
        raise BAD_EKI_TELEGRAM(what, wire=ElementTree.tostring(element)) from error


def require_matching_setup(state: ControllerState, context: RsiContext, variant: str) -> tuple[str, ...]:
    """Return the facts that the controller does not report; raises EKI-005 listing all mismatches."""
    reference = Reference.ABSOLUTE if context.program.corrections == "absolute" else Reference.RELATIVE
    facts = (
        ("cycle in ms", context.program.cycle_ms, state.cycle_ms),
        ("corrections", reference.value, state.reference),
        ("HOLDON", True, state.holdon),
        ("context hash", context_hash(context), state.context_hash),
        ("arm", find_arm(variant).reported_as, state.variant),
    )
    differences = [
        f"{name} is {stated}, not {expected}"
        for name, expected, stated in facts
        if stated is not None and stated != expected
    ]
    if differences:
        raise WRONG_CONTROLLER(
            "the controller is not set up for this driver: " + "; ".join(differences),
            expected=IN_A_CONTEXT if state.context_hash not in (None, context_hash(context)) else None,
        )
    return tuple(name for name, _, stated in facts if stated is None)


def require_ready(
    state: ControllerState, *, drives: bool, modes: tuple[OperationMode, ...] = (OperationMode.EXT,)
) -> None:
    """Raise EKI-007 listing every obstacle to motion; with `drives`, the drives must already be on."""
    if unmet := unmet_conditions(state, drives=drives, modes=modes):
        raise CONTROLLER_NOT_READY("the controller is not ready: " + "; ".join(unmet))


def unmet_conditions(state: ControllerState, *, drives: bool, modes: tuple[OperationMode, ...]) -> list[str]:
    """Describe every obstacle to motion."""
    unmet = []
    if state.mode not in modes:
        unmet.append(f"operating mode is {state.mode}, not {' or '.join(modes)}")
    if state.emergency_stop:
        unmet.append(f"{EMERGENCY_STOP} is active")
    if state.guard_open:
        unmet.append("the guard is open")
    if state.error:
        unmet.append(f"message {state.error} is not acknowledged")
    if drives and not state.drives:
        unmet.append("drives are off")
    return unmet


def _parse_number(text: str) -> float:
    """Parse a finite number; NaN would make every comparison false."""
    value = float(text)
    if not isfinite(value):
        raise ValueError(f"{text!r} is not a number")
    return value


def _parse_flag(element: ElementTree.Element, attribute: StateAttribute) -> bool:
    return bool(_parse_number(element.attrib[attribute]))
