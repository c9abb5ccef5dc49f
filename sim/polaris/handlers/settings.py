"""Settings: GET, GETINFO, SET, DFLT, SAVE, VSEL, IRATE, HCWDOG."""

from __future__ import annotations

import string

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF
from sim.polaris.handlers.arguments import digit_within
from sim.polaris.unit.mode import Mode
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit
from sim.polaris.unit.user_parameter_table import LONGEST_WATCH_DOG_S, WATCH_DOG


def get(unit: Unit, argument: str) -> str:
    """GET name, or a prefix and *."""
    return LF.join(
        f"{p.name}={unit.user_parameters.value(p.name)}" for p in unit.user_parameters.list(argument)
    )


def get_information(unit: Unit, argument: str) -> str:
    """GETINFO name"""
    return LF.join(unit.user_parameters.information(p) for p in unit.user_parameters.list(argument))


def set_parameter(unit: Unit, argument: str) -> None:
    """SET name=value"""
    name, equals, value = argument.partition("=")
    if not name or not equals:
        raise Refusal(ErrorCode.PARAMETER_COUNT)
    unit.user_parameters.set(name, value, tracking=unit.mode is Mode.TRACKING)


def set_default(unit: Unit, argument: str) -> None:
    """DFLT name, or a prefix and *."""
    unit.user_parameters.set_default(argument, tracking=unit.mode is Mode.TRACKING)


def save(unit: Unit, _argument: str) -> None:
    """SAVE: the settings survive a reset."""
    unit.user_parameters.save()


def select_volume(unit: Unit, argument: str) -> None:
    """VSEL n, counted from 1; the parameter counts from 0."""
    number = digit_within(argument, 1, len(unit.model.volumes), ErrorCode.NO_SUCH_VOLUME)
    unit.user_parameters.set(wire.PARAMETER_SELECTED_VOLUME, str(number - 1), tracking=False)


def illuminator_rate(unit: Unit, argument: str) -> None:
    """IRATE n"""
    number = digit_within(argument, 0, max(unit.model.illuminator_rates))
    unit.user_parameters.set(wire.PARAMETER_ILLUMINATOR_RATE, str(number), tracking=False)


def watch_dog(unit: Unit, argument: str) -> None:
    """HCWDOG n: seconds in decimal digits, 0 for off."""
    if not set(argument) <= set(string.digits) or int(argument[:9]) > LONGEST_WATCH_DOG_S:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    unit.user_parameters.set(WATCH_DOG, argument, tracking=False)
