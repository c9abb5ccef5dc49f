"""Start-up errors of the robot controller; later problems appear as messages to its clients."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError


class UnknownParameter(ConfigurationError):
    """The controller parameter does not exist or does not accept the value."""

    code = "URC-001"
    action = "Give --set NAME=VALUE; ronna-sim ur --list-parameters lists all names."


class BadAddress(ConfigurationError):
    """The address is none that a controller can have on this computer."""

    code = "URC-002"
    action = "Give a loopback address of its own for each arm, such as --address 127.0.0.9."
