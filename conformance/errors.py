"""Errors that prevent a conformance run from starting."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, RefusedError


class NoDeviceChosen(ConfigurationError):
    """The command line specifies no device to test, or more than one."""

    code = "CNF-001"
    action = "Give one of --sim, --config FILE and --endpoint [NAME=]URI."


class DeviceNotInFile(ConfigurationError):
    """The theatre file has no such device."""

    code = "CNF-002"
    action = "Name a device of the theatre file, with --device for one of several robots."


class NoSuchCase(ConfigurationError):
    """No case number starts with a prefix given to --only."""

    code = "CNF-003"
    action = "Run the suite without --only to see the numbers of its cases."


class NotConfirmed(RefusedError):
    """The suite would move a device other than our simulator without confirmation."""

    code = "CNF-005"
    action = (
        "Stand by the arm with the emergency stop in hand and give your name at the prompt, or with "
        "--confirmed-by if there is no terminal."
    )


class NoSimulator(ConfigurationError):
    """`--sim` was given, but there is no simulator for the driver's wire protocol."""

    code = "CNF-006"
    action = "Name the device with --endpoint or --config."
