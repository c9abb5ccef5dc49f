"""What keeps a conformance run from starting."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, RefusedError


class NoDeviceChosen(ConfigurationError):
    """The command line does not say, or says twice, what to test."""

    code = "CNF-001"
    action = "Give one of --sim, --config FILE and --endpoint [NAME=]URI."


class DeviceNotInFile(ConfigurationError):
    """The theatre file has no such device."""

    code = "CNF-002"
    action = "Name a device that the theatre file holds, with --device for one of several robots."


class NoSuchCase(ConfigurationError):
    """The command line names cases that the suite does not have."""

    code = "CNF-003"
    action = "Run the suite without --only to see the numbers of its cases."


class NotConfirmed(RefusedError):
    """A device that is no simulator of ours would be moved, and nobody has confirmed it."""

    code = "CNF-005"
    action = (
        "Stand beside the arm with the emergency stop in hand, and give your name when asked, or by "
        "--confirmed-by where nobody can be asked."
    )


class NoSimulator(ConfigurationError):
    """`--sim` is asked for a driver whose wire protocol has no simulator."""

    code = "CNF-006"
    action = "Name the device with --endpoint or --config."
