"""Commands of the line: COMM, ECHO."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from sim.polaris.handlers.arguments import need_length
from sim.polaris.line.line_settings import LineSettings
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit


def communication(unit: Unit, argument: str) -> str:
    """COMM: the reply is sent at the old settings."""
    need_length(argument, wire.COMM_ARGUMENT_DIGITS)
    try:
        settings = LineSettings.from_argument(argument)
    except KeyError:
        raise Refusal(unit.behaviour.malformed_line_settings) from None
    if argument[0] not in unit.model.baud_codes:
        raise Refusal(ErrorCode.COMMUNICATION_PARAMETERS)
    unit.line = settings
    return wire.REPLY_OKAY


def echo(unit: Unit, argument: str) -> str:
    """ECHO text: by this a host gets back in step when it has missed a reply."""
    unit.get_in_step()
    return argument
