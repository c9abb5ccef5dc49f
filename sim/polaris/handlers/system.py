"""Commands of the unit itself and of its line: INIT, RESET, VER, APIREV, BEEP, COMM, ECHO."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF
from sim.polaris.handlers.arguments import digit_within
from sim.polaris.line.line_settings import LineSettings
from sim.polaris.unit.alerts import HARDWARE
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

VERSION_CONTROL, VERSION_LEFT, VERSION_RIGHT, VERSION_WIRED, VERSION_ENHANCED, VERSION_COMBINED = range(6)
BEEPED, BUSY_BEEPING = "1", "0"
LONGEST_BEEP = 9
ABSENT = (
    "GETIO", "SETIO", "SENSEL", "GP", "PSTART", "PSTOP", "GETLOG", "SYSLOG", "VSNAP", "VGET", "VCAP",
)  # fmt: skip
FAULT_REPLIES = {"ERROR15": ErrorCode.CANNOT_INITIALISE, "ERROR1A": ErrorCode.INTERNAL}


def initialise(unit: Unit, _argument: str) -> str:
    """INIT"""
    reply = unit.behaviour.hardware_fault_at_init if unit.alerts.current & HARDWARE else wire.REPLY_OKAY
    if reply in FAULT_REPLIES:
        raise Refusal(FAULT_REPLIES[reply])
    unit.initialise()
    return reply


def reset(unit: Unit, argument: str) -> str:
    """RESET [n]"""
    if argument:
        digit_within(argument, 0, 1)
    unit.reset()
    return wire.REPLY_RESET


def version(unit: Unit, argument: str) -> str:
    """VER n"""
    which = digit_within(argument, VERSION_CONTROL, VERSION_COMBINED)
    model = unit.model
    if which == VERSION_COMBINED:
        return model.combined_revision
    if which == VERSION_WIRED and not unit.wired.tools:
        raise Refusal(ErrorCode.NO_FIRMWARE_VERSION)  # no tool interface unit is connected
    parts = {VERSION_LEFT: "Left Sensor", VERSION_RIGHT: "Right Sensor", VERSION_WIRED: "System Control Unit"}
    revision = model.firmware.rsplit(".", 1)[0]
    if not unit.behaviour.freeze_tag_with_minor:
        revision = revision.partition(".")[0]
    lines = (
        f"{model.name} {parts.get(which, 'Control')} Firmware",
        f"NDI S/N: {model.serial_number}",
        f"Characterization Date: {model.characterization_date}",
        f"Freeze Tag: {model.name} Rev {revision}",
        f"Freeze Date: {model.freeze_date}",
        "(C) Northern Digital Inc.",
    )
    return LF.join(lines)


def api_revision(unit: Unit, _argument: str) -> str:
    """APIREV"""
    return unit.model.api_revision


def beep(unit: Unit, argument: str) -> str:
    """BEEP n"""
    count = digit_within(argument, 1, LONGEST_BEEP)
    now_s = unit.clock.now_s()
    if now_s < unit.beeps_until_s:
        return BUSY_BEEPING
    unit.beeps_until_s = now_s + count * unit.behaviour.beep_s
    return BEEPED


def communication(unit: Unit, argument: str) -> None:
    """COMM: the reply is sent at the old settings."""
    try:
        settings = LineSettings.from_argument(argument)
    except KeyError:
        raise Refusal(unit.behaviour.malformed_line_settings) from None
    if argument[0] not in unit.model.baud_codes:
        raise Refusal(ErrorCode.COMMUNICATION_PARAMETERS)
    unit.line = settings


def echo(unit: Unit, argument: str) -> str:
    """ECHO text: lets a host resynchronise after a missed reply."""
    unit.get_in_step()
    return argument


def absent(unit: Unit, _argument: str) -> str:
    """A command that real units have but whose format is not public."""
    raise Refusal(unit.behaviour.absent_command)
