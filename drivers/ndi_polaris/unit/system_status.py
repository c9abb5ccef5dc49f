"""System status of a reply: fault, hold, or usable."""

from __future__ import annotations

from drivers.ndi_polaris.errors import (
    HardwareFailure,
    MalformedReply,
    SensorBumped,
    TemperatureHold,
    UnitError,
)
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.unit.user_parameters import read_parameter, whole_number
from ronna_hw.errors import DeviceError
from ronna_hw.wire.polaris import (
    PARAMETER_ALERTS,
    PARAMETER_BUMP_CLEAR,
    PARAMETER_BUMPED,
    PARAMETER_NEW_ALERTS,
    Alert,
    SystemStatus,
)

FAILURE_ALERTS = (
    Alert.FATAL_PARAMETER
    | Alert.SENSOR_PARAMETER
    | Alert.MAIN_VOLTAGE
    | Alert.SENSOR_VOLTAGE
    | Alert.ILLUMINATOR_VOLTAGE
    | Alert.ILLUMINATOR_CURRENT
    | Alert.LEFT_SENSOR_TEMPERATURE
    | Alert.RIGHT_SENSOR_TEMPERATURE
    | Alert.MAIN_BOARD_TEMPERATURE
    | Alert.FIRMWARE_INCOMPATIBLE
)
TEMPERATURE_ALERTS = Alert.TOO_HOT | Alert.TOO_COLD
DOUBTFUL_STATUS = int(
    SystemStatus.SYNC_ERROR
    | SystemStatus.TOO_MUCH_INFRARED
    | SystemStatus.CRC_ERROR
    | SystemStatus.RECOVERABLE_EXCEPTION
)
# All other bits leave poses valid: wired tools plugged in or out.
ALARMING_STATUS = int(
    SystemStatus.HARDWARE_FAILURE | SystemStatus.DIAGNOSTICS_PENDING | SystemStatus.TEMPERATURE
)


def alarm(bits: int, link: CommandLink, deadline_s: float) -> DeviceError | None:
    """The fault or hold indicated by the system status, or None.

    While diagnostics are pending the alerts are read, which also makes the unit send poses again.
    """
    status = SystemStatus(bits)
    alerts = read_new_alerts(link, deadline_s) if SystemStatus.DIAGNOSTICS_PENDING in status else Alert(0)
    if SystemStatus.HARDWARE_FAILURE in status or alerts & FAILURE_ALERTS:
        return HardwareFailure("the unit reports a hardware fault", got=_names(status, alerts))
    if Alert.BUMP in alerts:
        return SensorBumped("the unit was bumped", got=_names(status, alerts))
    if SystemStatus.TEMPERATURE in status or alerts & TEMPERATURE_ALERTS:
        return TemperatureHold(
            "the unit withholds poses: temperature out of range", got=_names(status, alerts)
        )
    return None


def read_new_alerts(link: CommandLink, deadline_s: float | None) -> Alert:
    """Alerts raised since they were last read; reading clears the pending bit."""
    value = read_parameter(link, PARAMETER_NEW_ALERTS, deadline_s)
    alerts = whole_number(value)
    if alerts is None:
        raise MalformedReply("unknown format of the alerts", got=value)
    return Alert(alerts)


def refuse_standing_trouble(link: CommandLink, deadline_s: float) -> None:
    """Raise NDI-020 or NDI-021 for a fault or a bump from before this connection that is still unread."""
    value = _value_or(link, PARAMETER_ALERTS, "0", deadline_s)
    alerts = Alert(whole_number(value) or 0)
    if alerts & FAILURE_ALERTS:
        raise HardwareFailure("the unit reports a hardware fault", got=_names(SystemStatus(0), alerts))
    if Alert.BUMP in alerts or _value_or(link, PARAMETER_BUMPED, "0", deadline_s) == "1":
        raise SensorBumped("the unit was bumped before this connection", got=_names(SystemStatus(0), alerts))


def clear_bump(link: CommandLink, deadline_s: float) -> None:
    """Acknowledge a bump; raises NDI-021 if the unit still reports one afterwards."""
    link.ask("SET", f"{PARAMETER_BUMP_CLEAR}=1", deadline_s=deadline_s)
    read_new_alerts(link, deadline_s)
    if read_parameter(link, PARAMETER_BUMPED, deadline_s) == "1":
        raise SensorBumped("the unit still reports a bump after it was cleared")


def _value_or(link: CommandLink, name: str, missing: str, deadline_s: float) -> str:
    try:
        return read_parameter(link, name, deadline_s)
    except UnitError:  # the unit does not have this parameter
        return missing


def _names(status: SystemStatus, alerts: Alert) -> str:
    text = f"system status {status.value:04X}"
    return f"{text}, alerts {alerts.name or hex(alerts.value)}" if alerts else text
