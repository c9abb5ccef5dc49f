"""Checks of command arguments that several commands share."""

from __future__ import annotations

import string

from ronna_hw.wire.polaris import HANDLE_DIGITS
from sim.polaris.tools.ports import Port
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

_HEXADECIMAL = frozenset(string.hexdigits)


def hexadecimal(text: str, refusal: ErrorCode = ErrorCode.OUT_OF_RANGE) -> int:
    """The value of hexadecimal digits in either case; raises `refusal` for anything else."""
    if not text or not _HEXADECIMAL.issuperset(text):
        raise Refusal(refusal)
    return int(text, 16)


def digit_within(argument: str, low: int, high: int, refusal: ErrorCode = ErrorCode.OUT_OF_RANGE) -> int:
    """The value of one decimal digit within a range; raises `refusal` for anything else."""
    if argument not in string.digits or not low <= int(argument) <= high:
        raise Refusal(refusal)
    return int(argument)


def port_of(unit: Unit, argument: str) -> Port:
    """The port whose handle starts the argument."""
    return unit.ports.port(hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE))


def occupied_port_of(unit: Unit, argument: str) -> Port:
    """The same, occupied; raises Refusal when its tool was unplugged or never plugged in."""
    port = port_of(unit, argument)
    if port.unoccupied:
        raise Refusal(ErrorCode.HANDLE_UNOCCUPIED)
    if not port.occupied:
        raise Refusal(ErrorCode.NO_TOOL)
    return port


def initialised_port_of(unit: Unit, argument: str) -> Port:
    """The same, initialised."""
    port = occupied_port_of(unit, argument)
    if not port.initialised:
        raise Refusal(ErrorCode.HANDLE_NOT_INITIALISED)
    return port


def wired_port_of(unit: Unit, argument: str) -> Port:
    """The port of a wired tool; raises Refusal for any other."""
    port = occupied_port_of(unit, argument)
    if not port.wired_port:
        raise Refusal(ErrorCode.NOT_FOR_THIS_DEVICE)
    return port
