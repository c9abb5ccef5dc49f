"""User parameters: names, values, and who may change them (GET, SET, GETINFO)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire import polaris as wire
from sim.polaris.alerts import Alerts
from sim.polaris.profile import Profile
from sim.polaris.refusal import ErrorCode, Refusal

LONGEST_TEXT = 255
DEVICE_PREFIX = "PS-0."  # names may carry the device they belong to
WILDCARD = "*"
TYPE_INTEGER, TYPE_TEXT = "1", "2"  # field `type` of GETINFO; the codes are not public
ATTRIBUTE_READ, ATTRIBUTE_WRITE = "1", "3"


@dataclass(frozen=True)
class Parameter:
    """One parameter. With `limits` it is a whole number, otherwise text."""

    name: str
    default: str
    description: str = ""
    writable: bool = False
    while_tracking: bool = False
    limits: tuple[int, int] | None = None


class Parameters:
    """All parameters of a unit, in the order in which a wildcard lists them."""

    def __init__(self, profile: Profile, alerts: Alerts, mode_name: Callable[[], str]) -> None:
        self._parameters = {parameter.name: parameter for parameter in _parameters(profile)}
        self._values = {name: parameter.default for name, parameter in self._parameters.items()}
        self._alerts = alerts
        self._live: dict[str, Callable[[], str]] = {
            "Info.Status.System Mode": mode_name,
            wire.PARAMETER_ALERTS: lambda: str(int(alerts.current)),
            wire.PARAMETER_NEW_ALERTS: lambda: str(alerts.read_new()),
            "Info.Status.Bump Detected": self._bumped,
            wire.PARAMETER_BUMPED: self._bumped,
        }

    def value(self, name: str) -> str:
        """The value of one parameter; raises Refusal for an unknown name."""
        known = self._known(name)
        live = self._live.get(known.name)
        return live() if live else self._values[known.name]

    def number(self, name: str) -> int:
        """The value of one whole-number parameter."""
        return int(self.value(name))

    def list(self, pattern: str) -> tuple[Parameter, ...]:
        """The parameters that a name, or the beginning of names and `*`, asks for."""
        if not pattern.endswith(WILDCARD):
            return (self._known(pattern),)
        beginning = pattern.removeprefix(DEVICE_PREFIX).removesuffix(WILDCARD)
        found = tuple(p for name, p in self._parameters.items() if name.startswith(beginning))
        if not found:
            raise Refusal(ErrorCode.NO_SUCH_PARAMETER)
        return found

    def information(self, parameter: Parameter) -> str:
        """One line of GETINFO: seven fields."""
        low, high = parameter.limits or ("", "")
        kind = TYPE_INTEGER if parameter.limits else TYPE_TEXT
        attribute = ATTRIBUTE_WRITE if parameter.writable else ATTRIBUTE_READ
        value = f"{parameter.name}={self.value(parameter.name)}"
        return ";".join((value, kind, attribute, str(low), str(high), "", parameter.description))

    def set(self, name: str, value: str, *, tracking: bool) -> None:
        """Change a parameter; raises Refusal when it does not exist, is read-only, or the value is wrong."""
        parameter = self._known(name)
        if not parameter.writable:
            raise Refusal(ErrorCode.READ_ONLY)
        if tracking and not parameter.while_tracking:
            raise Refusal(ErrorCode.WRONG_MODE)
        if parameter.limits is not None:
            value = str(_number_within(value, parameter.limits))
        elif len(value) > LONGEST_TEXT:
            raise Refusal(ErrorCode.WRONG_SIZE)
        self._values[parameter.name] = value
        if parameter.name == "Param.Simulated Alerts":
            self._alerts.set(int(value))
        elif parameter.name == wire.PARAMETER_BUMP_CLEAR and value == "1":
            self._alerts.clear_bump()
            self._values[parameter.name] = "0"

    def _known(self, name: str) -> Parameter:
        parameter = self._parameters.get(name.removeprefix(DEVICE_PREFIX))
        if parameter is None:
            raise Refusal(ErrorCode.NO_SUCH_PARAMETER)
        return parameter

    def _bumped(self) -> str:
        return "1" if self._alerts.current & wire.Alert.BUMP else "0"


def _number_within(value: str, limits: tuple[int, int]) -> int:
    if not (value.isascii() and value.removeprefix("-").isdigit()):
        raise Refusal(ErrorCode.WRONG_VALUE_TYPE)
    low, high = limits
    if len(value) > len(str(high)) + 1 or not low <= int(value) <= high:
        raise Refusal(ErrorCode.VALUE_OUT_OF_RANGE)
    return int(value)


def _parameters(profile: Profile) -> tuple[Parameter, ...]:
    major, minor, build = profile.firmware.split(".")
    volumes = ",".join(volume.name for volume in profile.volumes)
    all_alerts = int(sum(wire.Alert))
    features = (
        Parameter(wire.PARAMETER_MODEL, profile.model, "Hardware model"),
        Parameter(wire.PARAMETER_SERIAL, profile.serial_number, "Hardware serial number"),
        Parameter("Features.Hardware.OEM Number", "", "OEM number"),
        Parameter(wire.PARAMETER_FIRMWARE, profile.firmware, "Firmware version"),
        Parameter("Features.Firmware.Major Version", major),
        Parameter("Features.Firmware.Minor Version", minor),
        Parameter("Features.Firmware.Build Number", build),
        Parameter("Features.Firmware.Combined Firmware Revision", profile.combined_revision),
        Parameter("Features.Firmware.Package Number", profile.package),
        Parameter("Features.Tools.Enabled Tools", str(profile.enabled_tools), "Tools enabled at once"),
        Parameter("Features.Tools.Active Ports", "0"),
        Parameter("Features.Tools.Passive Ports", str(profile.passive_ports)),
        Parameter("Features.Tools.Wireless Ports", "1"),
    )
    settings = (
        Parameter("Param.Tracking.Available Volumes", volumes),
        Parameter(wire.PARAMETER_SELECTED_VOLUME, "0", "From 0", True, limits=(0, len(profile.volumes) - 1)),
        Parameter("Param.Tracking.Sensitivity", "4", "", True, limits=(1, 7)),
        Parameter(
            wire.PARAMETER_ILLUMINATOR_RATE,
            str(profile.illuminator_rate),
            "0 20 Hz, 1 30 Hz, 2 60 Hz",
            True,
            limits=(0, max(wire.ILLUMINATOR_RATES_HZ)),
        ),
        Parameter("Param.Default Wavelength.Return Warning", "1", "", True, limits=(0, 1)),
        Parameter("Param.Bump Detector.Bump Detection", "1", "", True, limits=(0, 1)),
        Parameter(wire.PARAMETER_BUMP_CLEAR, "0", "Write 1 to clear", True, True, limits=(0, 1)),
        Parameter(wire.PARAMETER_BUMPED, "0"),
        Parameter("Param.System Beeper", "1", "", True, limits=(0, 1)),
        Parameter("Param.Watch Dog Timer", "0", "Seconds, 0 off", True, limits=(0, 0)),
        Parameter("Param.Simulated Alerts", "0", "Raises alerts", True, True, limits=(0, all_alerts)),
        Parameter("Param.Host Connection", "0"),
        *(Parameter(f"Param.User.String{index}", "", "Free text", True, True) for index in range(5)),
    )
    status = (
        Parameter("Info.Status.System Mode", ""),
        Parameter(wire.PARAMETER_ALERTS, "0", "Present alerts"),
        Parameter(wire.PARAMETER_NEW_ALERTS, "0", "Cleared by reading"),
        Parameter("Info.Status.Alerts Overflow", "0"),
        Parameter("Info.Status.Bump Detected", "0"),
        Parameter("Info.Status.New Log Entry", "0"),
        *(
            Parameter(f"{wire.PARAMETER_TIMEOUT_PREFIX}{name}", f"{seconds:g}", "Seconds")
            for name, seconds in wire.COMMAND_TIMEOUT_S.items()
        ),
    )
    others = (
        Parameter("Config.Password", "", "", True),
        Parameter("Config.Combined Firmware Revision", profile.combined_revision),
        Parameter("Config.Ext Device Syncing", "0"),
        Parameter("Device.Type.0", "PS"),
        Parameter("Device.Instance.0", "0"),
    )
    return (*features, *settings, *status, *others)
