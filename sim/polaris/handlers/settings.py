"""Settings: GET, GETINFO, SET, DFLT, SAVE, VSEL, IRATE, HCWDOG."""

from __future__ import annotations

import string

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF
from sim.polaris.handlers.arguments import digit_within, no_argument
from sim.polaris.unit.mode import Mode
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit
from sim.polaris.unit.user_parameter_table import LONGEST_WATCH_DOG_S, WATCH_DOG


def get(unit: Unit, argument: str) -> str:
    """GET name, or a prefix and *."""
    _need_text(argument)
    return LF.join(f"{p.name}={unit.parameters.value(p.name)}" for p in unit.parameters.list(argument))


def get_information(unit: Unit, argument: str) -> str:
    """GETINFO name"""
    _need_text(argument)
    return LF.join(unit.parameters.information(p) for p in unit.parameters.list(argument))


def set_parameter(unit: Unit, argument: str) -> str:
    """SET name=value"""
    name, equals, value = argument.partition("=")
    if not name or not equals:
        raise Refusal(ErrorCode.PARAMETER_COUNT)
    unit.parameters.set(name, value, tracking=unit.mode is Mode.TRACKING)
    return wire.REPLY_OKAY


def set_default(unit: Unit, argument: str) -> str:
    """DFLT name, or a prefix and *."""
    _need_text(argument)
    unit.parameters.set_default(argument, tracking=unit.mode is Mode.TRACKING)
    return wire.REPLY_OKAY


def save(unit: Unit, argument: str) -> str:
    """SAVE: the settings survive a reset."""
    no_argument(argument)
    unit.parameters.save()
    return wire.REPLY_OKAY


def select_volume(unit: Unit, argument: str) -> str:
    """VSEL n, from 1; the parameter counts from 0."""
    number = digit_within(argument, 1, len(unit.model.volumes), ErrorCode.NO_SUCH_VOLUME)
    unit.parameters.set(wire.PARAMETER_SELECTED_VOLUME, str(number - 1), tracking=False)
    return wire.REPLY_OKAY


def illuminator_rate(unit: Unit, argument: str) -> str:
    """IRATE n"""
    number = digit_within(argument, 0, max(unit.model.illuminator_rates))
    unit.parameters.set(wire.PARAMETER_ILLUMINATOR_RATE, str(number), tracking=False)
    return wire.REPLY_OKAY


def watch_dog(unit: Unit, argument: str) -> str:
    """HCWDOG n: seconds in decimal digits, 0 for off."""
    _need_text(argument)
    if not set(argument) <= set(string.digits) or int(argument[:9]) > LONGEST_WATCH_DOG_S:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    unit.parameters.set(WATCH_DOG, argument, tracking=False)
    return wire.REPLY_OKAY


def _need_text(argument: str) -> None:
    if not argument:
        raise Refusal(ErrorCode.PARAMETER_COUNT)
