"""Every user parameter of a unit: its name, factory value, and who may change it."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.wire import polaris as wire
from sim.polaris.unit.model import UnitModel

LONGEST_WATCH_DOG_S = 3600
LARGEST_SENSITIVITY = 7
USER_STRINGS = 5
ALL_ALERTS = int(sum(wire.Alert))

SYSTEM_MODE = "Info.Status.System Mode"
BUMP_DETECTED = "Info.Status.Bump Detected"
BUMP_DETECTION = "Param.Bump Detector.Bump Detection"
SIMULATED_ALERTS = "Param.Simulated Alerts"
WATCH_DOG = "Param.Watch Dog Timer"
RETURN_WARNING = "Param.Default Wavelength.Return Warning"


@dataclass(frozen=True)
class Parameter:
    """One parameter: an integer if it has `limits`, otherwise text.

    `kept` parameters are stored by SAVE; `options` names the values of an enumeration.
    """

    name: str
    default: str
    description: str = ""
    writable: bool = False
    while_tracking: bool = False
    limits: tuple[int, int] | None = None
    kept: bool = False
    options: str = ""


def parameter_table(model: UnitModel, wired_ports: int) -> tuple[Parameter, ...]:
    """All parameters, in the order in which a wildcard lists them."""
    return (*_features(model, wired_ports), *_settings(model), *_status(), *_others(model))


def _features(model: UnitModel, wired_ports: int) -> tuple[Parameter, ...]:
    major, minor, build = model.firmware.split(".")
    return (
        Parameter(wire.PARAMETER_MODEL, model.name, "Hardware model"),
        Parameter(wire.PARAMETER_SERIAL, model.serial_number, "Hardware serial number"),
        Parameter("Features.Hardware.OEM Number", "", "OEM number"),
        Parameter(wire.PARAMETER_FIRMWARE, model.firmware, "Firmware version"),
        Parameter("Features.Firmware.Major Version", major),
        Parameter("Features.Firmware.Minor Version", minor),
        Parameter("Features.Firmware.Build Number", build),
        Parameter("Features.Firmware.Combined Firmware Revision", model.combined_revision),
        Parameter("Features.Firmware.Package Number", model.package),
        Parameter("Features.Tools.Enabled Tools", str(model.enabled_tools), "Tools enabled at once"),
        Parameter("Features.Tools.Active Ports", str(wired_ports)),
        Parameter("Features.Tools.Passive Ports", str(model.passive_ports)),
        Parameter("Features.Tools.Wireless Ports", str(model.wireless_ports)),
    )


def _settings(model: UnitModel) -> tuple[Parameter, ...]:
    volumes = ",".join(volume.name for volume in model.volumes)
    rates = ",".join(f"{wire.ILLUMINATOR_RATES_HZ[code]}Hz" for code in model.illuminator_rates)
    last_volume = len(model.volumes) - 1
    return (
        Parameter("Param.Tracking.Available Volumes", volumes),
        _number(wire.PARAMETER_SELECTED_VOLUME, 0, (0, last_volume), "From 0", options=volumes),
        _number("Param.Tracking.Sensitivity", 4, (1, LARGEST_SENSITIVITY), "Of the sensors"),
        _number(
            wire.PARAMETER_ILLUMINATOR_RATE,
            0,
            (0, max(model.illuminator_rates)),
            "Passive measurements per second",
            options=rates,
        ),
        _number(RETURN_WARNING, 1, (0, 1), "PINIT warns of a missing wavelength"),
        _number(BUMP_DETECTION, 1, (0, 1), "Bumps raise an alert"),
        Parameter(wire.PARAMETER_BUMP_CLEAR, "0", "Write 1 to clear", True, True, (0, 1)),
        Parameter(wire.PARAMETER_BUMPED, "0", "A bump has not been cleared"),
        _number("Param.System Beeper", 1, (0, 1), "Beeps at power-up", while_tracking=True),
        _number(WATCH_DOG, 0, (0, LONGEST_WATCH_DOG_S), "Seconds, 0 off", while_tracking=True),
        Parameter(SIMULATED_ALERTS, "0", "Raises alerts", True, True, (0, ALL_ALERTS)),
        Parameter("Param.Host Connection", "0", "0 serial"),
        *(
            Parameter(f"Param.User.String{index}", "", "Free text", True, True, kept=True)
            for index in range(USER_STRINGS)
        ),
    )


def _status() -> tuple[Parameter, ...]:
    timeouts = (
        Parameter(f"{wire.PARAMETER_TIMEOUT_PREFIX}{name}", f"{seconds:g}", "Seconds")
        for name, seconds in wire.COMMAND_TIMEOUT_S.items()
    )
    return (
        Parameter(SYSTEM_MODE, ""),
        Parameter(wire.PARAMETER_ALERTS, "0", "Present alerts"),
        Parameter(wire.PARAMETER_NEW_ALERTS, "0", "Cleared by reading"),
        Parameter("Info.Status.Alerts Overflow", "0"),
        Parameter(BUMP_DETECTED, "0"),
        Parameter("Info.Status.New Log Entry", "0"),
        *timeouts,
    )


def _others(model: UnitModel) -> tuple[Parameter, ...]:
    return (
        Parameter("Config.Password", "", "Opens further parameters", True),
        Parameter("Config.Combined Firmware Revision", model.combined_revision),
        Parameter("Config.Ext Device Syncing", "0"),
        Parameter("Device.Type.0", "PS"),
        Parameter("Device.Instance.0", "0"),
    )


def _number(
    name: str,
    default: int,
    limits: tuple[int, int],
    description: str,
    *,
    options: str = "",
    while_tracking: bool = False,
) -> Parameter:
    """An integer that hosts may set and SAVE stores."""
    return Parameter(
        name, str(default), description, True, while_tracking, limits, kept=True, options=options
    )
