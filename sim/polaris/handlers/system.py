"""Commands about the unit itself: INIT, RESET, VER, APIREV, SFLIST, SSTAT, COMM, BEEP, ECHO."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF
from sim.polaris.handlers.arguments import digit_within, hexadecimal, need_length, no_argument
from sim.polaris.refusal import ErrorCode, Refusal
from sim.polaris.unit import Unit

FEATURE_PASSIVE_PORTS = 0x0002
FEATURE_SEVERAL_VOLUMES = 0x0004
VERSION_CONTROL, VERSION_LEFT, VERSION_RIGHT, VERSION_WIRED, VERSION_ENHANCED, VERSION_COMBINED = range(6)
SYSTEM_CHECKS = 0x0007  # control, sensors, tool interface
HEALTHY = "00"
BEEPED = "1"
LONGEST_BEEP = 9


def initialise(unit: Unit, argument: str) -> str:
    """INIT"""
    no_argument(argument)
    unit.initialise()
    return wire.REPLY_OKAY


def reset(unit: Unit, argument: str) -> str:
    """RESET [n]"""
    need_length(argument, 0, 1)
    if argument:
        digit_within(argument, 0, 1)
    unit.reset()
    return wire.REPLY_RESET


def version(unit: Unit, argument: str) -> str:
    """VER n"""
    which = digit_within(argument, VERSION_CONTROL, VERSION_COMBINED)
    profile = unit.profile
    if which == VERSION_COMBINED:
        return profile.combined_revision
    if which == VERSION_WIRED:
        raise Refusal(ErrorCode.NO_FIRMWARE_VERSION)  # no interface for wired tools is connected
    part = {VERSION_LEFT: "Left Sensor", VERSION_RIGHT: "Right Sensor"}.get(which, "Control")
    revision = profile.firmware.rsplit(".", 1)[0]
    lines = (
        f"{profile.model} {part} Firmware",
        f"NDI S/N: {profile.serial_number}",
        f"Characterization Date: {profile.characterization_date}",
        f"Freeze Tag: {profile.model} Rev {revision}",
        f"Freeze Date: {profile.freeze_date}",
        "(C) Northern Digital Inc.",
    )
    return LF.join(lines)


def api_revision(unit: Unit, argument: str) -> str:
    """APIREV"""
    no_argument(argument)
    return unit.profile.api_revision


def feature_list(unit: Unit, argument: str) -> str:
    """SFLIST nn"""
    need_length(argument, 2)
    profile = unit.profile
    volumes = "".join(volume.feature_line() for volume in profile.volumes)
    several = FEATURE_SEVERAL_VOLUMES if len(profile.volumes) > 1 else 0
    lists = {
        0x00: f"{FEATURE_PASSIVE_PORTS | several:08X}",
        0x01: "0",  # active ports
        0x02: f"{profile.passive_ports}",
        int(wire.SFLIST_VOLUMES, 16): f"{len(profile.volumes)}{volumes}",
        0x04: "0",  # ports that sense a tool by its current
        0x05: "1",  # wireless ports
    }
    try:
        return lists[hexadecimal(argument)]
    except KeyError:
        raise Refusal(ErrorCode.OUT_OF_RANGE) from None


def system_checks(_unit: Unit, argument: str) -> str:
    """SSTAT oooo"""
    need_length(argument, 4)
    asked = hexadecimal(argument)
    if not asked or asked & ~SYSTEM_CHECKS:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    return HEALTHY * asked.bit_count()


def communication(unit: Unit, argument: str) -> str:
    """COMM: the answer goes out at the old rate."""
    need_length(argument, wire.COMM_ARGUMENT_DIGITS)
    baud, others = argument[0], argument[1:]
    tables = (wire.COMM_DATA_BITS, wire.COMM_PARITY, wire.COMM_STOP_BITS, wire.COMM_HANDSHAKE)
    known = baud in wire.COMM_BAUD_CODES
    if not known or not all(code in table for code, table in zip(others, tables, strict=True)):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    if baud not in unit.profile.baud_codes:
        raise Refusal(ErrorCode.COMMUNICATION_PARAMETERS)
    unit.switch_baud(baud)
    return wire.REPLY_OKAY


def beep(_unit: Unit, argument: str) -> str:
    """BEEP n"""
    digit_within(argument, 1, LONGEST_BEEP)
    return BEEPED


def echo(_unit: Unit, argument: str) -> str:
    """ECHO text"""
    return argument
