"""Errors raised by the console itself."""

from __future__ import annotations

from ronna_hw.errors import EXIT_USAGE, ErrorCode, RonnaError

PORT_TAKEN = ErrorCode(
    "CON-001",
    RonnaError,
    "Another program is listening on the console's port.",
    "Choose another port, or omit it to use any free port.",
    own_exit_code=EXIT_USAGE,
)


NOTHING_TO_SHOW = ErrorCode(
    "CON-002",
    RonnaError,
    "The folder contains no run that the console can show.",
    "Give the folder of a run made by this version; ronna-procedure list shows them.",
    own_exit_code=EXIT_USAGE,
)


UNRELIABLE_RUN = ErrorCode(
    "CON-003",
    RonnaError,
    "The run folder is truncated, was altered, or comes from another version.",
    "ronna-procedure verify lists everything.",
)
