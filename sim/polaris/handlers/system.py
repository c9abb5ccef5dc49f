"""Handlers for commands concerning the unit and its settings.

INIT, RESET, VER, APIREV, BEEP, COMM, ECHO; GET, GETINFO, SET, DFLT, SAVE, VSEL, IRATE, HCWDOG; SFLIST, SSTAT.
"""

from __future__ import annotations

import string

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import LF, Alert
from sim.polaris.tracker_unit import SimulatedUnit, UnitMode
from sim.polaris.unit.framing import LineSettings
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, digit_within, hexadecimal
from sim.polaris.unit.user_parameters import HARDWARE_ALERTS, LONGEST_WATCH_DOG_S, WATCH_DOG

VERSION_CONTROL, VERSION_LEFT, VERSION_RIGHT, VERSION_WIRED, VERSION_ENHANCED, VERSION_COMBINED = range(6)
BEEPED, BUSY_BEEPING = "1", "0"
LONGEST_BEEP = 9
ABSENT = (
    "GETIO", "SETIO", "SENSEL", "GP", "PSTART", "PSTOP", "GETLOG", "SYSLOG", "VSNAP", "VGET", "VCAP",
)  # fmt: skip
FAULT_REPLIES = {"ERROR15": NdiErrorCode.CANNOT_INITIALISE, "ERROR1A": NdiErrorCode.INTERNAL}

FEATURE_ACTIVE_PORTS = 0x0001
FEATURE_PASSIVE_PORTS = 0x0002
FEATURE_SEVERAL_VOLUMES = 0x0004
FEATURE_TOOL_IN_PORT = 0x0008
FEATURE_ACTIVE_WIRELESS = 0x0010
AURORA_LISTS = (0x10, 0x12)

CONTROL, SENSORS, TOOL_INTERFACE = 0x0001, 0x0002, 0x0004  # options of SSTAT, in the order of the reply
CONTROL_SYSTEM_CHECKSUM = 0x02
LEFT_ROM, RIGHT_ROM = 0x01, 0x10
INTERFACE_VOLTAGES = 0x02


def initialise(unit: SimulatedUnit, _argument: str) -> str:
    """INIT"""
    reply = (
        unit.behaviour.hardware_fault_at_init if unit.alerts.current & HARDWARE_ALERTS else wire.REPLY_OKAY
    )
    if reply in FAULT_REPLIES:
        raise CommandRefusal(FAULT_REPLIES[reply])
    unit.initialise()
    return reply


def reset(unit: SimulatedUnit, argument: str) -> str:
    """RESET [n]"""
    if argument:
        digit_within(argument, 0, 1)
    unit.reset()
    return wire.REPLY_RESET


def version(unit: SimulatedUnit, argument: str) -> str:
    """VER n"""
    which = digit_within(argument, VERSION_CONTROL, VERSION_COMBINED)
    model = unit.model
    if which == VERSION_COMBINED:
        return model.combined_revision
    if which == VERSION_WIRED and not unit.wired.tools:
        raise CommandRefusal(NdiErrorCode.NO_FIRMWARE_VERSION)  # no tool interface unit is connected
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


def api_revision(unit: SimulatedUnit, _argument: str) -> str:
    """APIREV"""
    return unit.model.api_revision


def beep(unit: SimulatedUnit, argument: str) -> str:
    """BEEP n"""
    count = digit_within(argument, 1, LONGEST_BEEP)
    now_s = unit.clock.now_s()
    if now_s < unit.beeps_until_s:
        return BUSY_BEEPING
    unit.beeps_until_s = now_s + count * unit.behaviour.beep_s
    return BEEPED


def communication(unit: SimulatedUnit, argument: str) -> None:
    """COMM: the reply is still sent with the old settings."""
    try:
        settings = LineSettings.from_argument(argument)
    except KeyError:
        raise CommandRefusal(unit.behaviour.malformed_line_settings) from None
    if argument[0] not in unit.model.baud_codes:
        raise CommandRefusal(NdiErrorCode.COMMUNICATION_PARAMETERS)
    unit.line = settings


def echo(unit: SimulatedUnit, argument: str) -> str:
    """ECHO text: lets a host resynchronise after a missed reply."""
    unit.resend_frame()
    return argument


def absent(unit: SimulatedUnit, _argument: str) -> str:
    """Refuse a command for which real units use an undocumented format."""
    raise CommandRefusal(unit.behaviour.absent_command)


def get(unit: SimulatedUnit, argument: str) -> str:
    """GET name, or a prefix and *."""
    return LF.join(
        f"{p.name}={unit.user_parameters.value(p.name)}" for p in unit.user_parameters.list(argument)
    )


def get_information(unit: SimulatedUnit, argument: str) -> str:
    """GETINFO name"""
    return LF.join(unit.user_parameters.information(p) for p in unit.user_parameters.list(argument))


def set_parameter(unit: SimulatedUnit, argument: str) -> None:
    """SET name=value"""
    name, equals, value = argument.partition("=")
    if not name or not equals:
        raise CommandRefusal(NdiErrorCode.PARAMETER_COUNT)
    unit.user_parameters.set(name, value, tracking=unit.mode is UnitMode.TRACKING)


def set_default(unit: SimulatedUnit, argument: str) -> None:
    """DFLT name, or a prefix and *."""
    unit.user_parameters.set_default(argument, tracking=unit.mode is UnitMode.TRACKING)


def save(unit: SimulatedUnit, _argument: str) -> None:
    """SAVE: keep the settings across a reset."""
    unit.user_parameters.save()


def select_volume(unit: SimulatedUnit, argument: str) -> None:
    """VSEL n, counted from 1; the parameter counts from 0."""
    number = digit_within(argument, 1, len(unit.model.volumes), NdiErrorCode.NO_SUCH_VOLUME)
    unit.user_parameters.set(wire.PARAMETER_SELECTED_VOLUME, str(number - 1), tracking=False)


def illuminator_rate(unit: SimulatedUnit, argument: str) -> None:
    """IRATE n"""
    number = digit_within(argument, 0, max(unit.model.illuminator_rates))
    unit.user_parameters.set(wire.PARAMETER_ILLUMINATOR_RATE, str(number), tracking=False)


def watch_dog(unit: SimulatedUnit, argument: str) -> None:
    """HCWDOG n: seconds in decimal digits, 0 for off."""
    if not set(argument) <= set(string.digits) or int(argument[:9]) > LONGEST_WATCH_DOG_S:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    unit.user_parameters.set(WATCH_DOG, argument, tracking=False)


def feature_list(unit: SimulatedUnit, argument: str) -> str:
    """SFLIST nn"""
    model = unit.model
    volumes = "".join(volume.feature_line() for volume in model.volumes)
    lists = {
        0x00: f"{_feature_bits(unit):08X}",
        0x01: f"{unit.wired.count:X}",
        0x02: f"{model.passive_ports:X}",
        int(wire.SFLIST_VOLUMES, 16): f"{len(model.volumes)}{volumes}",
        0x04: f"{unit.wired.count:X}",  # ports that sense current
        0x05: f"{model.wireless_ports:X}",
    }
    number = hexadecimal(argument)
    if number in AURORA_LISTS:
        raise CommandRefusal(NdiErrorCode.NO_FEATURE_LIST)
    if number not in lists:
        raise CommandRefusal(unit.behaviour.unknown_feature_list)
    return lists[number]


def system_checks(unit: SimulatedUnit, argument: str) -> str:
    """SSTAT oooo: two digits per option, 00 when healthy."""
    requested_options = hexadecimal(argument)
    if not requested_options or requested_options & ~(CONTROL | SENSORS | TOOL_INTERFACE):
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    alerts = unit.alerts.current
    sensors_wrong = alerts & (Alert.SENSOR_PARAMETER | Alert.SENSOR_VOLTAGE)
    found = {
        CONTROL: CONTROL_SYSTEM_CHECKSUM if alerts & Alert.FATAL_PARAMETER else 0,
        SENSORS: LEFT_ROM | RIGHT_ROM if sensors_wrong else 0,
        TOOL_INTERFACE: INTERFACE_VOLTAGES if alerts & Alert.MAIN_VOLTAGE else 0,
    }
    return "".join(f"{value:02X}" for option, value in found.items() if requested_options & option)


def _feature_bits(unit: SimulatedUnit) -> int:
    model = unit.model
    return (
        FEATURE_PASSIVE_PORTS
        | (FEATURE_ACTIVE_PORTS | FEATURE_TOOL_IN_PORT if unit.wired.count else 0)
        | (FEATURE_SEVERAL_VOLUMES if len(model.volumes) > 1 else 0)
        | (FEATURE_ACTIVE_WIRELESS if model.wireless_ports else 0)
    )
