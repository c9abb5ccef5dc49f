"""Start-up errors of the robot controller; later problems appear as messages to its clients."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ErrorCode

UNKNOWN_PARAMETER = ErrorCode(
    "URC-001",
    ConfigurationError,
    "The controller parameter does not exist or does not accept the value.",
    "Give --set NAME=VALUE; ronna-sim ur --list-parameters lists all names.",
)


BAD_ADDRESS = ErrorCode(
    "URC-002",
    ConfigurationError,
    "The address is none that a controller can have on this computer.",
    "Give a loopback address of its own for each arm, such as --address 127.0.0.9.",
)
