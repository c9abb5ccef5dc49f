"""Errors of the live feed and of the flight log."""

from __future__ import annotations

from ronna_hw.errors import ConnectError, DataError, ErrorCode

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
