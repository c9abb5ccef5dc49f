"""Error and warning codes of the unit, command refusal and numeric argument checks."""

from __future__ import annotations

import string
from enum import IntEnum

_HEXADECIMAL = frozenset(string.hexdigits)


class NdiErrorCode(IntEnum):
    """Error codes sent by this unit, explained in `ronna_hw.wire.polaris.ERROR_MEANINGS`."""

    UNKNOWN_COMMAND = 0x01
    TOO_LONG = 0x02
    TOO_SHORT = 0x03
    WRONG_CRC = 0x04
    COMMUNICATION_PARAMETERS = 0x06
    PARAMETER_COUNT = 0x07
    BAD_HANDLE = 0x08
    BAD_PRIORITY = 0x09
    BAD_LED_NUMBER = 0x0A
    BAD_LED_STATE = 0x0B
    WRONG_MODE = 0x0C
    NO_TOOL = 0x0D
    HANDLE_NOT_INITIALISED = 0x0E
    HANDLE_NOT_ENABLED = 0x0F
    NOT_INITIALISED = 0x10
    CANNOT_START_TRACKING = 0x12
    BAD_DEFINITION = 0x13
    CANNOT_INITIALISE = 0x15
    CANNOT_START_DIAGNOSTIC = 0x16
    NO_FIRMWARE_VERSION = 0x19
    INTERNAL = 0x1A
    INFRARED_CHECK_NOT_READY = 0x1B
    CANNOT_READ_MEMORY = 0x1E
    CANNOT_WRITE_MEMORY = 0x1F
    CANNOT_SELECT_MEMORY = 0x20
    CURRENT_TEST_FAILED = 0x21
    WAVELENGTH = 0x22
    OUT_OF_RANGE = 0x23
    NO_SUCH_VOLUME = 0x24
    NO_FEATURE_LIST = 0x25
    TOO_MANY_ENABLED = 0x28
    HANDLE_NOT_ALLOCATED = 0x2B
    HANDLE_UNOCCUPIED = 0x2C
    NO_HANDLES_LEFT = 0x2D
    BAD_PORT_DESCRIPTION = 0x2F
    PORT_HAS_HANDLE = 0x30
    NOT_FOR_THIS_DEVICE = 0x32
    NOT_AVAILABLE = 0x33
    NO_SUCH_PARAMETER = 0x34
    WRONG_VALUE_TYPE = 0x35
    VALUE_OUT_OF_RANGE = 0x36
    WRONG_SIZE = 0x38
    READ_ONLY = 0x39
    DEFINITION_CORRUPT = 0x40
    DEFINITION_BEYOND_LIMITS = 0x41
    TOO_MUCH_INFRARED = 0xF1


class WarningCode(IntEnum):
    """`WARNINGhh` codes, explained in `ronna_hw.wire.polaris.WARNING_MEANINGS`."""

    HARDWARE = 0x01
    GEOMETRY_NOT_UNIQUE = 0x02
    CONFLICTS_WITH_TOOL = 0x03
    NOT_UNIQUE_AND_CONFLICTS = 0x04
    DEFAULT_WAVELENGTH = 0x05


class CommandRefusal(Exception):
    """The command was refused and has no effect."""

    def __init__(self, code: NdiErrorCode) -> None:
        super().__init__(code.name)
        self.code = code


def hexadecimal(text: str, refusal: NdiErrorCode = NdiErrorCode.OUT_OF_RANGE) -> int:
    """Parse hexadecimal digits in either case; raises `refusal` for anything else."""
    if not text or not _HEXADECIMAL.issuperset(text):
        raise CommandRefusal(refusal)
    return int(text, 16)


def digit_within(
    argument: str, low: int, high: int, refusal: NdiErrorCode = NdiErrorCode.OUT_OF_RANGE
) -> int:
    """Parse a decimal digit from `low` to `high`; raises `refusal` for anything else."""
    if argument not in string.digits or not low <= int(argument) <= high:
        raise CommandRefusal(refusal)
    return int(argument)
