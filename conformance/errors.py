"""Errors that prevent a conformance run from starting."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ErrorCode, RefusedError

NO_DEVICE_CHOSEN = ErrorCode(
    "CNF-001",
    ConfigurationError,
    "The command line specifies no device to test, or more than one.",
    "Give one of --sim, --config FILE and --endpoint [NAME=]URI.",
)


DEVICE_NOT_IN_FILE = ErrorCode(
    "CNF-002",
    ConfigurationError,
    "The theatre file has no such device.",
    "Name a device of the theatre file, with --device for one of several robots.",
)


NO_SUCH_CASE = ErrorCode(
    "CNF-003",
    ConfigurationError,
    "No case number starts with a prefix given to --only.",
    "Run the suite without --only to see the numbers of its cases.",
)


class NotConfirmed(RefusedError):
    """The suite would move a device other than our simulator without confirmation."""

    code = "CNF-005"
    action = (
        "Stand by the arm with the emergency stop in hand and give your name at the prompt, or with "
        "--confirmed-by if there is no terminal."
    )


NO_SIMULATOR = ErrorCode(
    "CNF-006",
    ConfigurationError,
    "`--sim` was given, but there is no simulator for the driver's wire protocol.",
    "Name the device with --endpoint or --config.",
)
