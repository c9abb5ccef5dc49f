"""Errors of the live feed and of the flight log."""

from __future__ import annotations

from ronna_hw.errors import EXIT_USAGE, ConfigurationError, ConnectError, DataError, ErrorCode

NO_FEED = ErrorCode(
    "LIV-001",
    ConnectError,
    "No case is running in this folder.",
    "Name the folder of a run while its case is running, on the computer and as the user that runs it.",
)
FEED_UNREADABLE = ErrorCode(
    "LIV-002",
    DataError,
    "The live feed of a case sends what this version cannot read.",
    "Read it with the version that runs the case.",
)
NAME_TOO_LONG = ErrorCode(
    "LIV-010",
    ConfigurationError,
    "A name does not fit into the header of an OpenIGTLink message.",
    "Give the device or frame a shorter name of ASCII letters; other programs would see it cut.",
)
ADDRESS_UNUSABLE = ErrorCode(
    "LIV-011",
    ConfigurationError,
    "The OpenIGTLink server cannot listen at the given address.",
    "Give an address of this computer, as `ip address` lists them, and a free port.",
    own_exit_code=EXIT_USAGE,
)
