"""Commands about settings: GET, GETINFO, SET, VSEL, IRATE."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF
from sim.polaris.handlers.arguments import digit_within
from sim.polaris.refusal import ErrorCode, Refusal
from sim.polaris.unit import Mode, Unit


def get(unit: Unit, argument: str) -> str:
    """GET name, or the beginning of names and *"""
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


def select_volume(unit: Unit, argument: str) -> str:
    """VSEL n, from 1; the parameter counts from 0."""
    number = digit_within(argument, 1, len(unit.profile.volumes), ErrorCode.NO_SUCH_VOLUME)
    unit.parameters.set(wire.PARAMETER_SELECTED_VOLUME, str(number - 1), tracking=False)
    return wire.REPLY_OKAY


def illuminator_rate(unit: Unit, argument: str) -> str:
    """IRATE n"""
    number = digit_within(argument, 0, max(wire.ILLUMINATOR_RATES_HZ))
    unit.parameters.set(wire.PARAMETER_ILLUMINATOR_RATE, str(number), tracking=False)
    return wire.REPLY_OKAY


def _need_text(argument: str) -> None:
    if not argument:
        raise Refusal(ErrorCode.PARAMETER_COUNT)
