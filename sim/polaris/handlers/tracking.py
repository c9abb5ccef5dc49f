"""Commands about tracking: TSTART, TSTOP, TX, BX."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import ReplyOption
from sim.polaris.framing import ascii_reply, binary_reply
from sim.polaris.handlers.arguments import hexadecimal, need_length, no_argument
from sim.polaris.refusal import ErrorCode, Refusal
from sim.polaris.replies import binary_body, text_reply
from sim.polaris.unit import Unit

OPTION_DIGITS = 4
START_OPTIONS = int(wire.TSTART_RESET_FRAME_COUNTER, 16) | int(wire.TSTART_FASTER, 16)
# Active strays and tool markers belong to wired tools and to other units.
OPTIONS = (
    ReplyOption.TRANSFORMS
    | ReplyOption.TOOL_INFORMATION
    | ReplyOption.OUT_OF_VOLUME
    | ReplyOption.STRAY_PASSIVE
)


def start(unit: Unit, argument: str) -> str:
    """TSTART [80]"""
    need_length(argument, 0, 2)
    options = hexadecimal(argument) if argument else 0
    if options & ~START_OPTIONS:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    enabled = unit.ports.enabled()
    if len({port.dummy for port in enabled}) > 1:  # a dummy beside real tools of its type
        raise Refusal(ErrorCode.CANNOT_START_TRACKING)
    unit.start_tracking(restart=bool(options & int(wire.TSTART_RESET_FRAME_COUNTER, 16)))
    return wire.REPLY_OKAY


def stop(unit: Unit, argument: str) -> str:
    """TSTOP"""
    no_argument(argument)
    unit.stop_tracking()
    return wire.REPLY_OKAY


def text_frame(unit: Unit, argument: str) -> bytes:
    """TX [oooo]"""
    options = _options(argument)
    return ascii_reply(text_reply(unit.frame(), options, unit.profile))


def binary_frame(unit: Unit, argument: str) -> bytes:
    """BX [oooo]"""
    options = _options(argument)
    return binary_reply(binary_body(unit.frame(), options, unit.profile))


def _options(argument: str) -> ReplyOption:
    need_length(argument, 0, OPTION_DIGITS)
    asked = hexadecimal(argument) if argument else int(ReplyOption.TRANSFORMS)
    if not asked or asked & ~int(OPTIONS):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    return ReplyOption(asked)
