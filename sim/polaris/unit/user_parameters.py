"""User parameters (GET, GETINFO, SET, DFLT, SAVE), including alerts that hosts read and clear."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import Alert, SystemStatus
from sim.polaris.unit.model import UnitModel
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode

LONGEST_WATCH_DOG_S = 3600
LARGEST_SENSITIVITY = 7
USER_STRINGS = 5
ALL_ALERTS = int(sum(Alert))

SYSTEM_MODE = "Info.Status.System Mode"
BUMP_DETECTED = "Info.Status.Bump Detected"
BUMP_DETECTION = "Param.Bump Detector.Bump Detection"
SIMULATED_ALERTS = "Param.Simulated Alerts"
WATCH_DOG = "Param.Watch Dog Timer"
RETURN_WARNING = "Param.Default Wavelength.Return Warning"

HARDWARE_ALERTS = (
    Alert.FATAL_PARAMETER
    | Alert.SENSOR_PARAMETER
    | Alert.MAIN_VOLTAGE
    | Alert.SENSOR_VOLTAGE
    | Alert.ILLUMINATOR_VOLTAGE
    | Alert.ILLUMINATOR_CURRENT
    | Alert.LEFT_SENSOR_TEMPERATURE
    | Alert.RIGHT_SENSOR_TEMPERATURE
    | Alert.MAIN_BOARD_TEMPERATURE
)
TEMPERATURE_ALERTS = Alert.TOO_HOT | Alert.TOO_COLD

LONGEST_TEXT = 255
DEVICE_PREFIX = "PS-0."  # names may include their device
WILDCARD = "*"
TYPE_INTEGER, TYPE_TEXT = "1", "2"  # field `type` of GETINFO; the codes are not public
ATTRIBUTE_READ, ATTRIBUTE_WRITE = "1", "3"


class UserParameters:
    """All parameters of a unit, with those stored by SAVE surviving `reset`."""

    def __init__(
        self, model: UnitModel, wired_ports: int, alerts: Alerts, mode_name: Callable[[], str]
    ) -> None:
        self._parameters = {parameter.name: parameter for parameter in parameter_table(model, wired_ports)}
        self._values = {name: parameter.default for name, parameter in self._parameters.items()}
        self._saved: dict[str, str] = {}
        self._alerts = alerts
        self._live: dict[str, Callable[[], str]] = {
            SYSTEM_MODE: mode_name,
            wire.PARAMETER_ALERTS: lambda: str(int(alerts.current)),
            wire.PARAMETER_NEW_ALERTS: lambda: str(alerts.read_new()),
            BUMP_DETECTED: self._bump_status,
            wire.PARAMETER_BUMPED: self._bump_status,
        }

    def value(self, name: str) -> str:
        """Return a parameter's value; raises CommandRefusal if the name is unknown."""
        known = self._require_parameter(name)
        live = self._live.get(known.name)
        return live() if live else self._values[known.name]

    def number(self, name: str) -> int:
        """Return an integer parameter's value."""
        return int(self.value(name))

    def list(self, pattern: str) -> tuple[Parameter, ...]:
        """Return the parameters matching a name or a prefix and `*`; raises CommandRefusal if none match."""
        if not pattern.endswith(WILDCARD):
            return (self._require_parameter(pattern),)
        beginning = pattern.removeprefix(DEVICE_PREFIX).removesuffix(WILDCARD)
        found = tuple(p for name, p in self._parameters.items() if name.startswith(beginning))
        if not found:
            raise CommandRefusal(NdiErrorCode.NO_SUCH_PARAMETER)
        return found

    def information(self, parameter: Parameter) -> str:
        """Return a parameter's GETINFO line, with seven fields."""
        low, high = parameter.limits or ("", "")
        kind = TYPE_INTEGER if parameter.limits else TYPE_TEXT
        attribute = ATTRIBUTE_WRITE if parameter.writable else ATTRIBUTE_READ
        value = f"{parameter.name}={self.value(parameter.name)}"
        fields = (value, kind, attribute, str(low), str(high), parameter.options, parameter.description)
        return ";".join(fields)

    def set(self, name: str, value: str, *, tracking: bool) -> None:
        """Set a parameter; raises CommandRefusal if it is unknown or read-only, or the value invalid."""
        parameter = self._require_writable(name, tracking=tracking)
        if parameter.limits is not None:
            value = str(_parse_number_within(value, parameter.limits))
        elif len(value) > LONGEST_TEXT:
            raise CommandRefusal(NdiErrorCode.WRONG_SIZE)
        self._store(parameter, value)

    def set_default(self, pattern: str, *, tracking: bool) -> None:
        """Restore factory values, with a wildcard skipping parameters that cannot be written now."""
        if not pattern.endswith(WILDCARD):
            parameter = self._require_writable(pattern, tracking=tracking)
            self._store(parameter, parameter.default)
            return
        for parameter in self.list(pattern):
            if parameter.writable and (parameter.while_tracking or not tracking):
                self._store(parameter, parameter.default)

    def save(self) -> None:
        """Store the current settings, to be restored by a reset."""
        self._saved = {name: self._values[name] for name, p in self._parameters.items() if p.kept}

    def save_value(self, name: str, value: str) -> None:
        """Set and store one setting, as an earlier user of the unit might have done."""
        self.set(name, value, tracking=False)
        self._saved[name] = value

    def reset(self) -> None:
        """Restore the stored values."""
        self._values = {name: p.default for name, p in self._parameters.items()} | self._saved
        self._alerts.detects_bumps = self._values[BUMP_DETECTION] == "1"

    def _store(self, parameter: Parameter, value: str) -> None:
        if parameter.name == wire.PARAMETER_BUMP_CLEAR:
            if value == "1":
                self._alerts.clear_bump()
            return  # always reads 0
        self._values[parameter.name] = value
        if parameter.name == SIMULATED_ALERTS:
            self._alerts.simulate(int(value))
        elif parameter.name == BUMP_DETECTION:
            self._alerts.detects_bumps = value == "1"

    def _require_writable(self, name: str, *, tracking: bool) -> Parameter:
        parameter = self._require_parameter(name)
        if not parameter.writable:
            raise CommandRefusal(NdiErrorCode.READ_ONLY)
        if tracking and not parameter.while_tracking:
            raise CommandRefusal(NdiErrorCode.WRONG_MODE)
        return parameter

    def _require_parameter(self, name: str) -> Parameter:
        parameter = self._parameters.get(name.removeprefix(DEVICE_PREFIX))
        if parameter is None:
            raise CommandRefusal(NdiErrorCode.NO_SUCH_PARAMETER)
        return parameter

    def _bump_status(self) -> str:
        return "1" if self._alerts.current & Alert.BUMP else "0"


def _parse_number_within(value: str, limits: tuple[int, int]) -> int:
    if not (value.isascii() and value.removeprefix("-").isdigit()):
        raise CommandRefusal(NdiErrorCode.WRONG_VALUE_TYPE)
    low, high = limits
    if len(value) > len(str(high)) + 1 or not low <= int(value) <= high:
        raise CommandRefusal(NdiErrorCode.VALUE_OUT_OF_RANGE)
    return int(value)


@dataclass(frozen=True)
class Parameter:
    """A parameter: an integer if it has `limits`, otherwise text.

    SAVE stores `kept` parameters; `options` names the values of an enumeration.
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
    """Return all parameters with factory values, in wildcard listing order."""
    return (*_feature_parameters(model, wired_ports), *_setting_parameters(model), *_status_parameters(model))


def _feature_parameters(model: UnitModel, wired_ports: int) -> tuple[Parameter, ...]:
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


def _setting_parameters(model: UnitModel) -> tuple[Parameter, ...]:
    volumes = ",".join(volume.name for volume in model.volumes)
    rates = ",".join(f"{wire.ILLUMINATOR_RATES_HZ[code]}Hz" for code in model.illuminator_rates)
    last_volume = len(model.volumes) - 1
    return (
        Parameter("Param.Tracking.Available Volumes", volumes),
        _number_parameter(wire.PARAMETER_SELECTED_VOLUME, 0, (0, last_volume), "From 0", options=volumes),
        _number_parameter("Param.Tracking.Sensitivity", 4, (1, LARGEST_SENSITIVITY), "Of the sensors"),
        _number_parameter(
            wire.PARAMETER_ILLUMINATOR_RATE,
            0,
            (0, max(model.illuminator_rates)),
            "Passive measurements per second",
            options=rates,
        ),
        _number_parameter(RETURN_WARNING, 1, (0, 1), "PINIT warns of a missing wavelength"),
        _number_parameter(BUMP_DETECTION, 1, (0, 1), "Bumps raise an alert"),
        Parameter(wire.PARAMETER_BUMP_CLEAR, "0", "Write 1 to clear", True, True, (0, 1)),
        Parameter(wire.PARAMETER_BUMPED, "0", "A bump has not been cleared"),
        _number_parameter("Param.System Beeper", 1, (0, 1), "Beeps at power-up", while_tracking=True),
        _number_parameter(WATCH_DOG, 0, (0, LONGEST_WATCH_DOG_S), "Seconds, 0 off", while_tracking=True),
        Parameter(SIMULATED_ALERTS, "0", "Raises alerts", True, True, (0, ALL_ALERTS)),
        Parameter("Param.Host Connection", "0", "0 serial"),
        *(
            Parameter(f"Param.User.String{index}", "", "Free text", True, True, kept=True)
            for index in range(USER_STRINGS)
        ),
    )


def _status_parameters(model: UnitModel) -> tuple[Parameter, ...]:
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
        Parameter("Config.Password", "", "Opens further parameters", True),
        Parameter("Config.Combined Firmware Revision", model.combined_revision),
        Parameter("Config.Ext Device Syncing", "0"),
        Parameter("Device.Type.0", "PS"),
        Parameter("Device.Instance.0", "0"),
    )


def _number_parameter(
    name: str,
    default: int,
    limits: tuple[int, int],
    description: str,
    *,
    options: str = "",
    while_tracking: bool = False,
) -> Parameter:
    """Define an integer parameter that hosts may set and save."""
    return Parameter(
        name, str(default), description, True, while_tracking, limits, kept=True, options=options
    )


class Alerts:
    """Current alerts, and new alerts that are cleared by reading.

    Three sources: simulated by the host, actual lasting problems, and a bump, which stays until cleared.
    """

    def __init__(self) -> None:
        self.detects_bumps = True
        self.system_status = SystemStatus(0)  # bits that alerts set in TX and BX
        self.current = Alert(0)
        self._new = Alert(0)
        self._simulated = Alert(0)
        self._lasting = Alert(0)
        self._raised = Alert(0)

    def reset(self) -> None:
        """Clear bump and simulated alerts at power-up, leaving lasting alerts to be redetected."""
        self._simulated = self._raised = self._new = self.current = Alert(0)
        self._update()

    def simulate(self, bits: int) -> None:
        """Set the alerts simulated by the host (`Param.Simulated Alerts`)."""
        self._simulated = Alert(bits & ALL_ALERTS)
        self._update()

    def set_lasting(self, bits: int) -> None:
        """Set the alerts for ongoing problems."""
        self._lasting = Alert(bits & ALL_ALERTS)
        self._update()

    def raise_alert(self, alert: Alert) -> None:
        """Raise an alert until the host clears it, ignoring bumps if their detection is off."""
        if alert is Alert.BUMP and not self.detects_bumps:
            return
        self._new |= alert  # a second bump is also a new alert
        self._raised |= alert
        self._update()

    def clear_bump(self) -> None:
        """Clear the bump alert."""
        self._raised &= ~Alert.BUMP
        self._simulated &= ~Alert.BUMP
        self._new &= ~Alert.BUMP
        self._update()

    def read_new(self) -> int:
        """Return and clear the unread alerts."""
        new = int(self._new)
        self._new = Alert(0)
        self._update()
        return new

    def _update(self) -> None:
        current = self._simulated | self._lasting | self._raised
        self._new |= current & ~self.current
        self.current = current
        status = SystemStatus(0)
        if self._new:
            status |= SystemStatus.DIAGNOSTICS_PENDING
        if current & HARDWARE_ALERTS:
            status |= SystemStatus.HARDWARE_FAILURE
        if current & TEMPERATURE_ALERTS:
            status |= SystemStatus.TEMPERATURE
        self.system_status = status
