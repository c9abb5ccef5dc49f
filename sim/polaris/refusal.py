"""Why the unit refuses a command: the codes it answers as `ERRORhh`."""

from __future__ import annotations

from enum import IntEnum


class ErrorCode(IntEnum):
    """Codes that this unit answers; their meanings are in `ronna_hw.wire.polaris.ERROR_MEANINGS`."""

    UNKNOWN_COMMAND = 0x01
    TOO_LONG = 0x02
    TOO_SHORT = 0x03
    WRONG_CRC = 0x04
    COMMUNICATION_PARAMETERS = 0x06
    PARAMETER_COUNT = 0x07
    BAD_HANDLE = 0x08
    BAD_PRIORITY = 0x09
    WRONG_MODE = 0x0C
    NO_TOOL = 0x0D
    HANDLE_NOT_INITIALISED = 0x0E
    HANDLE_NOT_ENABLED = 0x0F
    NOT_INITIALISED = 0x10
    CANNOT_START_TRACKING = 0x12
    BAD_DEFINITION = 0x13
    NO_FIRMWARE_VERSION = 0x19
    OUT_OF_RANGE = 0x23
    NO_SUCH_VOLUME = 0x24
    TOO_MANY_ENABLED = 0x28
    HANDLE_NOT_ALLOCATED = 0x2B
    NO_HANDLES_LEFT = 0x2D
    BAD_PORT_DESCRIPTION = 0x2F
    NOT_FOR_THIS_DEVICE = 0x32
    NO_SUCH_PARAMETER = 0x34
    WRONG_VALUE_TYPE = 0x35
    VALUE_OUT_OF_RANGE = 0x36
    WRONG_SIZE = 0x38
    READ_ONLY = 0x39


class Refusal(Exception):
    """A command is not carried out and has no effect."""

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code.name)
        self.code = code
