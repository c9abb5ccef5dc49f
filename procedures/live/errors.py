"""Errors of the live feed, of the flight log and of the OpenIGTLink server."""

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
FOREIGN_LOG = ErrorCode(
    "LIV-003",
    DataError,
    "The file is no log of a run: it is not in MCAP.",
    "Name a run, or a file of it such as RUN/flight.mcap.",
)
EMPTY_LOG = ErrorCode(
    "LIV-004",
    DataError,
    "Nothing can be recovered from the log: it holds no whole message.",
    "It was cut within its first second, or damaged; see RUN/events.jsonl and RUN/readings instead.",
)
NO_LOG = ErrorCode(
    "LIV-005",
    DataError,
    "The run has no log.",
    "Runs of earlier versions have none, nor has one whose disk was full: RUN/log.jsonl says so.",
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
