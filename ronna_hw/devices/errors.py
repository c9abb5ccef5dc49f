"""Errors that any device may raise, whatever its protocol."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, StateError


class WrongState(StateError):
    """A call came in a lifecycle state that does not allow it."""

    code = "DEV-001"
    action = "Bring the device to the awaited state first; after a fault, call recover."


class UnknownDriver(ConfigurationError):
    """The theatre file names a driver that no installed package offers."""

    code = "DEV-002"
    action = "Check the driver name in the theatre file, or install the package that offers it."
