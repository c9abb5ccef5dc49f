"""Outputs of wired tools (LED, PSOUT), and commands without a public format."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS
from sim.polaris.handlers.arguments import hexadecimal, initialised_port_of, need_length, wired_port_of
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

ABSENT = (
    "GETIO", "SETIO", "SENSEL", "GP", "PSTART", "PSTOP", "GETLOG", "SYSLOG", "VSNAP", "VGET", "VCAP",
)  # fmt: skip
LIGHTS = "123"
LIGHT_STATES = "BFS"  # blank, flash, solid
OUTPUTS = 3
OUTPUT_STATES = frozenset("NSPO")  # no change, solid, pulse, off


def light(unit: Unit, argument: str) -> str:
    """LED hh n s"""
    need_length(argument, HANDLE_DIGITS + 2)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    number, state = argument[HANDLE_DIGITS], argument[HANDLE_DIGITS + 1]
    if number not in LIGHTS:
        raise Refusal(ErrorCode.BAD_LED_NUMBER)
    if state not in LIGHT_STATES:
        raise Refusal(ErrorCode.BAD_LED_STATE)
    wired_port_of(unit, argument)
    initialised_port_of(unit, argument)
    return wire.REPLY_OKAY


def general_purpose(unit: Unit, argument: str) -> str:
    """PSOUT hh abc"""
    need_length(argument, HANDLE_DIGITS + OUTPUTS)
    hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)
    if not OUTPUT_STATES.issuperset(argument[HANDLE_DIGITS:]):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    wired_port_of(unit, argument)
    initialised_port_of(unit, argument)
    return wire.REPLY_OKAY


def absent(unit: Unit, _argument: str) -> str:
    """A command that real units have but whose format is not public."""
    raise Refusal(unit.behaviour.absent_command)
