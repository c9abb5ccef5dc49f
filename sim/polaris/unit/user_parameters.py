"""User parameters: values, access, and what SAVE keeps (GET, GETINFO, SET, DFLT, SAVE)."""

from __future__ import annotations

from collections.abc import Callable

from ronna_hw.wire import polaris as wire
from sim.polaris.unit.alerts import Alerts
from sim.polaris.unit.model import UnitModel
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.user_parameter_table import (
    BUMP_DETECTED,
    BUMP_DETECTION,
    SIMULATED_ALERTS,
    SYSTEM_MODE,
    Parameter,
    parameter_table,
)

LONGEST_TEXT = 255
DEVICE_PREFIX = "PS-0."  # names may include their device
WILDCARD = "*"
TYPE_INTEGER, TYPE_TEXT = "1", "2"  # field `type` of GETINFO; the codes are not public
ATTRIBUTE_READ, ATTRIBUTE_WRITE = "1", "3"


class UserParameters:
    """All parameters of a unit. Saved values survive `reset`, like a power cut."""

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
            BUMP_DETECTED: self._bumped,
            wire.PARAMETER_BUMPED: self._bumped,
        }

    def value(self, name: str) -> str:
        """The value of one parameter; raises Refusal for an unknown name."""
        known = self._known(name)
        live = self._live.get(known.name)
        return live() if live else self._values[known.name]

    def number(self, name: str) -> int:
        """The value of one integer parameter."""
        return int(self.value(name))

    def list(self, pattern: str) -> tuple[Parameter, ...]:
        """The parameters selected by a name, or by a prefix and `*`."""
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
        fields = (value, kind, attribute, str(low), str(high), parameter.options, parameter.description)
        return ";".join(fields)

    def set(self, name: str, value: str, *, tracking: bool) -> None:
        """Change a parameter; raises Refusal if it does not exist, is read-only, or the value is invalid."""
        parameter = self._writable(name, tracking=tracking)
        if parameter.limits is not None:
            value = str(_number_within(value, parameter.limits))
        elif len(value) > LONGEST_TEXT:
            raise Refusal(ErrorCode.WRONG_SIZE)
        self._store(parameter, value)

    def set_default(self, pattern: str, *, tracking: bool) -> None:
        """Restore factory values; a wildcard skips read-only ones."""
        if not pattern.endswith(WILDCARD):
            parameter = self._writable(pattern, tracking=tracking)
            self._store(parameter, parameter.default)
            return
        for parameter in self.list(pattern):
            if parameter.writable and (parameter.while_tracking or not tracking):
                self._store(parameter, parameter.default)

    def save(self) -> None:
        """Save the current settings for after a reset."""
        self._saved = {name: self._values[name] for name, p in self._parameters.items() if p.kept}

    def save_value(self, name: str, value: str) -> None:
        """Set and save one setting, like an earlier user of the unit."""
        self.set(name, value, tracking=False)
        self._saved[name] = value

    def reset(self) -> None:
        """Restore the saved values."""
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

    def _writable(self, name: str, *, tracking: bool) -> Parameter:
        parameter = self._known(name)
        if not parameter.writable:
            raise Refusal(ErrorCode.READ_ONLY)
        if tracking and not parameter.while_tracking:
            raise Refusal(ErrorCode.WRONG_MODE)
        return parameter

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
