"""Errors that any device may raise, whatever its protocol."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, LinkTimeout, RefusedError, StateError


class WrongState(StateError):
    """A call came in a lifecycle state that does not allow it."""

    code = "DEV-001"
    action = "Bring the device to the expected state first; after a fault, call recover."


class UnknownDriver(ConfigurationError):
    """The theatre file names a driver that no installed package offers."""

    code = "DEV-002"
    action = "Check the driver name in the theatre file, or install the package that offers it."


class NotInTheatre(ConfigurationError, KeyError):
    """The theatre file does not have the device or the table that is asked for."""

    code = "DEV-007"
    action = "Add its table to the theatre file, with driver and endpoint, or ask for one that is there."

    __str__ = Exception.__str__  # a KeyError shows its message in quotes


class WrongKind(ConfigurationError):
    """A device of the theatre file does not offer the interface that is asked for."""

    code = "DEV-008"
    action = "Name a driver of that kind in the device's table, or ask for the interface that it has."


class NoNewFrame(LinkTimeout):
    """The tracker replies, but makes no new measurement within the time limit."""

    code = "DEV-009"
    action = "Check that the tracker is tracking, and give it more than one frame period."


class UnknownTool(ConfigurationError, LookupError):
    """A tool is asked for that is not among the tools of the tracker."""

    code = "DEV-003"
    action = "Use a name of the tracker's tools in the theatre file, or add the tool there."


class NoPose(DataError):
    """A reading is asked for a pose that it does not have, or that is not to be trusted."""

    code = "DEV-004"
    action = "Look at the validity of the reading before its pose."


class BadStrays(DataError):
    """Strays that are to be grouped are no positions, or the parameters of the grouping are impossible."""

    code = "DEV-005"
    action = "Give positions of three finite numbers in mm, a positive radius and a share from 0 to 1."


class NobodyNamed(RefusedError, ValueError):
    """A fault is to be acknowledged, or a danger confirmed, in nobody's name."""

    code = "DEV-006"
    action = "Give the name of the person who stands for it."
