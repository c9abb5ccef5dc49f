"""Tracker errors NDI-001 to NDI-037; `error_for(hh)` maps the vendor code of ERRORhh to its NDI-03x."""

from __future__ import annotations

from typing import ClassVar

from ronna_hw.devices.errors import ACKNOWLEDGE
from ronna_hw.errors import (
    EXIT_LINK_LOST,
    EXIT_SAFETY_STOP,
    ConfigurationError,
    ConnectError,
    DataError,
    DeviceError,
    ErrorCode,
    LinkTimeout,
    ProtocolError,
)
from ronna_hw.wire.polaris import ERROR_MEANINGS, REPLY_ERROR


class PortUnavailable(ConnectError):
    """The serial port or the TCP address cannot be opened."""

    code = "NDI-001"
    action = "Check cable, power, address and permission, and that no other program holds the port."
    number: int | None = None  # of the system's error
    reason = ""  # in the system's words


NOTHING_ANSWERS = ErrorCode(
    "NDI-002",
    ConnectError,
    "The line is open, but no unit replies at any baud rate, even after a break.",
    "Check that the unit is powered and warmed up, and that this is its port.",
)


class NotAPolaris(ConnectError):
    """The device on the line is not a Polaris unit."""

    code = "NDI-003"
    action = "Check the endpoint: another device or program is on this port."


WRONG_UNIT = ErrorCode(
    "NDI-004",
    ConnectError,
    "The Polaris unit is not the expected model, or has another serial number.",
    "Connect the right unit, or correct the expected model or serial number in the theatre file.",
)


class BadReplyCrc(ProtocolError):
    """A reply has a wrong CRC and was discarded."""

    code = "NDI-005"
    action = "One retry is automatic; if it recurs, check the cable and lower maximum_baud."


class MalformedReply(ProtocolError):
    """A reply to a command is malformed."""

    code = "NDI-006"
    action = "Check the firmware version of the unit; keep the bytes for a report."


class NoReply(LinkTimeout):
    """The unit did not reply within the command's time limit."""

    code = "NDI-007"
    action = "Try again: the next command resynchronises the link first."


class LinkLost(LinkTimeout):
    """The unit has been silent beyond its own time limits, or the line was closed."""

    code = "NDI-008"
    action = f"Check power and cable. To reconnect, {ACKNOWLEDGE}."


class UnitRestarted(DeviceError):
    """The unit was power-cycled, reset or re-initialised while connected."""

    code = "NDI-009"
    action = f"To reconnect, {ACKNOWLEDGE}. Poses from before the restart are void."
    exit_code = EXIT_LINK_LOST


BAD_OPTIONS = ErrorCode(
    "NDI-010",
    ConfigurationError,
    "The tracker options in the theatre file contain mistakes.",
    "Correct the tracker's options; docs/reference/tracker-options.md lists them.",
)


BAD_TOOL_FILE = ErrorCode(
    "NDI-011",
    DataError,
    "A tool definition is missing, invalid or corrupt.",
    "Use the .rom of the tool, or regenerate it from the marker coordinates.",
)


SAME_GEOMETRY = ErrorCode(
    "NDI-012",
    ConfigurationError,
    "Two tools are indistinguishable because their marker distances are too similar.",
    "Use tools whose marker distances differ by several millimetres.",
)


FOREIGN_TOOL = ErrorCode(
    "NDI-013",
    DataError,
    "A tool definition is valid but belongs to a different tool.",
    "Use the .rom of this tool; if it was changed on purpose, correct sha256 in the theatre file.",
)


class HardwareFailure(DeviceError):
    """The unit reports a hardware fault, so its poses must not be used."""

    code = "NDI-020"
    action = "Power-cycle the unit; if the fault persists, have it serviced."


class SensorBumped(DeviceError):
    """The unit was bumped and may have moved or lost its calibration."""

    code = "NDI-021"
    action = f"Check the unit and its stand, then {ACKNOWLEDGE}. Repeat all measurements made with the unit."
    exit_code = EXIT_SAFETY_STOP


class TemperatureHold(DeviceError):
    """The unit is outside its temperature range and withholds poses."""

    code = "NDI-022"
    action = "Wait: tracking resumes by itself when the temperature is in range."


class UnitError(DeviceError):
    """The unit replied ERRORhh; `vendor_code` is its number."""

    vendor_codes: ClassVar[frozenset[int]] = frozenset()

    def __init__(self, vendor_code: int, command: str = "") -> None:
        self.vendor_code = vendor_code
        meaning = ERROR_MEANINGS.get(vendor_code, "undocumented code")
        to = f" to {command}" if command else ""
        super().__init__(f"the unit replied {REPLY_ERROR}{vendor_code:02X}{to}: {meaning}")


class CommandRejected(UnitError):
    """The unit rejected a command's format or parameter."""

    code = "NDI-030"
    action = "Check the tracker's options and the firmware version of the unit."
    vendor_codes = frozenset(
        {0x01, 0x02, 0x03, 0x07, 0x08, 0x09, 0x0A, 0x0B, 0x23, 0x2F, 0x35, 0x36, 0x37, 0x38}
    )


class CommandGarbled(UnitError):
    """A command reached the unit with a wrong CRC and was ignored."""

    code = "NDI-031"
    action = "One retry is automatic; if it recurs, check the cable and lower maximum_baud."
    vendor_codes = frozenset({0x04})


class WrongMode(UnitError):
    """A command is not valid in the current mode of the unit, such as tracking."""

    code = "NDI-032"
    action = "Another program may be using the unit, or its watchdog stopped tracking; activate again."
    vendor_codes = frozenset({0x0C})


class NotInitialised(UnitError):
    """The unit needs INIT after power-up or reset."""

    code = "NDI-033"
    action = "Reconnect; if it happens while connected, the unit has restarted."
    vendor_codes = frozenset({0x10})


class HandleRefused(UnitError):
    """A port handle is free, empty, not initialised or not enabled, or no handle is available."""

    code = "NDI-034"
    action = "Configure again to reload all tools; load fewer tools if no handle is left."
    vendor_codes = frozenset({0x0D, 0x0E, 0x0F, 0x2B, 0x2C, 0x2D, 0x30, 0x32})


class ToolRefused(UnitError):
    """The unit rejected a tool definition, by itself or in combination with others."""

    code = "NDI-035"
    action = "Check the tool's .rom, the number of tools and the selected volume."
    vendor_codes = frozenset({0x13, 0x1C, 0x1D, 0x1E, 0x1F, 0x20, 0x21, 0x22, 0x28, 0x40, 0x41})


class NotOffered(UnitError):
    """The unit does not support this feature, parameter, volume or line setting."""

    code = "NDI-036"
    action = "Omit the option, or use a unit that has it."
    vendor_codes = frozenset({0x06, 0x24, 0x25, 0x33, 0x34, 0x39, 0x42})


class UnitFault(UnitError):
    """The unit failed to execute a command for an internal reason."""

    code = "NDI-037"
    action = "Power-cycle the unit; if the error recurs, have it serviced."
    # every vendor code that no other class names


_BY_VENDOR_CODE: dict[int, type[UnitError]] = {
    vendor_code: kind for kind in UnitError.__subclasses__() for vendor_code in kind.vendor_codes
}


def error_for(vendor_code: int, command: str = "") -> UnitError:
    """Build the typed error for an ERRORhh reply to `command`."""
    return _BY_VENDOR_CODE.get(vendor_code, UnitFault)(vendor_code, command)
