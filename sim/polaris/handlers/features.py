"""Feature lists and self-test: SFLIST, SSTAT."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import Alert
from sim.polaris.handlers.arguments import hexadecimal
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

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


def feature_list(unit: Unit, argument: str) -> str:
    """SFLIST nn"""
    model = unit.model
    volumes = "".join(volume.feature_line() for volume in model.volumes)
    lists = {
        0x00: f"{_features(unit):08X}",
        0x01: f"{unit.wired.count:X}",
        0x02: f"{model.passive_ports:X}",
        int(wire.SFLIST_VOLUMES, 16): f"{len(model.volumes)}{volumes}",
        0x04: f"{unit.wired.count:X}",  # ports with current sensing
        0x05: f"{model.wireless_ports:X}",
    }
    number = hexadecimal(argument)
    if number in AURORA_LISTS:
        raise Refusal(ErrorCode.NO_FEATURE_LIST)
    if number not in lists:
        raise Refusal(unit.behaviour.unknown_feature_list)
    return lists[number]


def system_checks(unit: Unit, argument: str) -> str:
    """SSTAT oooo: two digits per option, 00 when healthy."""
    asked = hexadecimal(argument)
    if not asked or asked & ~(CONTROL | SENSORS | TOOL_INTERFACE):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    alerts = unit.alerts.current
    sensors_wrong = alerts & (Alert.SENSOR_PARAMETER | Alert.SENSOR_VOLTAGE)
    found = {
        CONTROL: CONTROL_SYSTEM_CHECKSUM if alerts & Alert.FATAL_PARAMETER else 0,
        SENSORS: LEFT_ROM | RIGHT_ROM if sensors_wrong else 0,
        TOOL_INTERFACE: INTERFACE_VOLTAGES if alerts & Alert.MAIN_VOLTAGE else 0,
    }
    return "".join(f"{value:02X}" for option, value in found.items() if asked & option)


def _features(unit: Unit) -> int:
    model = unit.model
    return (
        FEATURE_PASSIVE_PORTS
        | (FEATURE_ACTIVE_PORTS | FEATURE_TOOL_IN_PORT if unit.wired.count else 0)
        | (FEATURE_SEVERAL_VOLUMES if len(model.volumes) > 1 else 0)
        | (FEATURE_ACTIVE_WIRELESS if model.wireless_ports else 0)
    )
