"""Unit status and settings: identity, parameters, alerts, illuminator rate, time limits."""

from __future__ import annotations

from contextlib import suppress

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.errors import (
    WRONG_UNIT,
    HardwareFailure,
    MalformedReply,
    NotAPolaris,
    SensorBumped,
    TemperatureHold,
    UnitError,
)
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import DeviceError
from ronna_hw.wire import polaris as ndi
from ronna_hw.wire.polaris import Alert, SystemStatus

PARAMETER_REPLY_BYTES = 256
MOST_DIGITS = 10  # of 32 bits
VENDOR = "NDI"
FAMILY = "Polaris"
VERSION_TEXT_BYTES = 512
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
TIME_LIMITS_BYTES = 2048  # about sixty lines of thirty characters
LONGEST_BELIEVED_S = 60.0  # no command takes longer; a longer limit would only hide a dead link
_MODEL_ENDS_AT = " Control Firmware"


def read_identity(link: CommandLink) -> Identity:
    """Read model, serial number and firmware; raises NDI-003 if the device is not a Polaris."""
    text = _ask_or_empty(link, "VER", "4") or _ask_or_empty(link, "VER", "0")
    lines = text.split(ndi.LF)
    model = lines[0].split(_MODEL_ENDS_AT)[0].strip()
    if FAMILY.lower() not in model.lower():
        raise NotAPolaris("the device does not identify itself as a Polaris", got=model or "no model")
    pairs = (line.partition(":") for line in lines[1:] if ":" in line)
    fields = {name.strip().lower(): value.strip() for name, _, value in pairs}
    firmware = read_parameter_or(link, ndi.PARAMETER_FIRMWARE, "")
    details = {
        "freeze tag": fields.get("freeze tag", ""),
        "characterization date": fields.get("characterization date", ""),
        "api revision": _ask_or_empty(link, "APIREV", ""),
        "combined firmware": _ask_or_empty(link, "VER", "5"),
    }
    return Identity(
        vendor=VENDOR,
        model=model,
        serial=fields.get("ndi s/n", ""),
        firmware=firmware or fields.get("freeze tag", ""),
        details=tuple((name, value.strip()) for name, value in details.items() if value.strip()),
    )


def names_model(identity: Identity, model: str) -> bool:
    """Return whether a unit identifies itself as this model."""
    return model.lower() in identity.model.lower()


def check_identity(identity: Identity, model: str | None, serial: str | None) -> None:
    """Raise NDI-004 unless model and serial number are as expected; None accepts any."""
    if model is not None and not names_model(identity, model):
        raise WRONG_UNIT("wrong model of unit", expected=model, got=identity.model)
    if serial is not None and serial != identity.serial:
        raise WRONG_UNIT("wrong serial number", expected=serial, got=identity.serial or "none")


def _ask_or_empty(link: CommandLink, name: str, argument: str) -> str:
    """Return the reply to a command, or an empty text if the unit rejects the command."""
    try:
        return link.ask(name, argument, reply_bytes=VERSION_TEXT_BYTES)
    except UnitError:
        return ""


def refuse_pending_alerts(link: CommandLink) -> None:
    """Raise NDI-020 or NDI-021 for a fault or bump that predates this connection."""
    alerts = Alert(parse_whole_number(read_parameter_or(link, ndi.PARAMETER_ALERTS, "0")) or 0)
    got = _describe_status(SystemStatus(0), alerts)
    if alerts & FAILURE_ALERTS:
        raise HardwareFailure("the unit reports a hardware fault", got=got)
    if Alert.BUMP in alerts or read_parameter_or(link, ndi.PARAMETER_BUMPED, "0") == "1":
        raise SensorBumped("the unit was bumped before this connection", got=got)


def find_alarm(bits: int, link: CommandLink) -> DeviceError | None:
    """Return the error indicated by the system status, if any.

    While diagnostics are pending the alerts are read, which also makes the unit send poses again.
    """
    status = SystemStatus(bits)
    alerts = read_new_alerts(link) if SystemStatus.DIAGNOSTICS_PENDING in status else Alert(0)
    got = _describe_status(status, alerts)
    if SystemStatus.HARDWARE_FAILURE in status or alerts & FAILURE_ALERTS:
        return HardwareFailure("the unit reports a hardware fault", got=got)
    if Alert.BUMP in alerts:
        return SensorBumped("the unit was bumped", got=got)
    if SystemStatus.TEMPERATURE in status or alerts & TEMPERATURE_ALERTS:
        return TemperatureHold("the unit withholds poses: temperature out of range", got=got)
    return None


def read_new_alerts(link: CommandLink) -> Alert:
    """Read new alerts, which also clears the pending bit."""
    value = read_parameter(link, ndi.PARAMETER_NEW_ALERTS)
    if (alerts := parse_whole_number(value)) is None:
        raise MalformedReply("unknown format of the alerts", got=value)
    return Alert(alerts)


def clear_bump(link: CommandLink) -> None:
    """Clear a bump; raises NDI-021 if the unit still reports one."""
    link.ask("SET", f"{ndi.PARAMETER_BUMP_CLEAR}=1")
    read_new_alerts(link)
    if read_parameter(link, ndi.PARAMETER_BUMPED) == "1":
        raise SensorBumped("the unit still reports a bump after it was cleared")


def set_illuminator_rate(link: CommandLink, rate_hz: int) -> int:
    """Set the illuminator rate by SET, or by IRATE on older firmware, and return the rate in use, Hz."""
    code = next(code for code, rate in ndi.ILLUMINATOR_RATES_HZ.items() if rate == rate_hz)
    for name, argument in (("SET", f"{ndi.PARAMETER_ILLUMINATOR_RATE}={code}"), ("IRATE", f"{code}")):
        try:
            link.ask(name, argument)
        except UnitError:
            continue
        return rate_hz
    kept_code = parse_whole_number(read_parameter_or(link, ndi.PARAMETER_ILLUMINATOR_RATE, ""))
    return ndi.ILLUMINATOR_RATES_HZ.get(kept_code or 0, min(ndi.ILLUMINATOR_RATES_HZ.values()))


def read_time_limits(link: CommandLink) -> dict[str, float]:
    """Read the unit's time limits by command, in seconds; empty if not reported."""
    try:
        text = link.ask("GET", f"{ndi.PARAMETER_TIMEOUT_PREFIX}*", reply_bytes=TIME_LIMITS_BYTES)
    except UnitError:
        return {}
    limits_s = {}
    for line in text.split(ndi.LF):
        parameter, _, value = line.partition("=")
        _, found, command = parameter.rpartition(ndi.PARAMETER_TIMEOUT_PREFIX)
        with suppress(ValueError):  # a value that is no number
            if found and command in ndi.COMMAND_TIMEOUT_S and 0.0 < float(value) <= LONGEST_BELIEVED_S:
                limits_s[command] = float(value)
    return limits_s


def read_parameter(link: CommandLink, name: str) -> str:
    """Read a parameter; raises NDI-036 if the unit lacks it, NDI-006 if the reply is for another one."""
    for _ in range(2):
        text = link.ask("GET", name, reply_bytes=PARAMETER_REPLY_BYTES)
        replied_name, _, value = text.partition("=")
        if replied_name.endswith(name):  # some firmware prefixes the name with the device
            return value.strip()
        link.mark_unsettled()  # a late copy of another reply
    raise MalformedReply(f"GET {name} returned another parameter", wire=text.encode())


def parse_whole_number(value: str) -> int | None:
    """Parse a parameter as an integer of up to ten digits, or return None."""
    return int(value) if value.isdecimal() and len(value) <= MOST_DIGITS else None


def read_parameter_or(link: CommandLink, name: str, missing: str) -> str:
    """Read a parameter, or return `missing` if the unit lacks it."""
    try:
        return read_parameter(link, name)
    except UnitError:
        return missing


def _describe_status(status: SystemStatus, alerts: Alert) -> str:
    text = f"system status {status.value:04X}"
    return f"{text}, alerts {alerts.name or hex(alerts.value)}" if alerts else text
