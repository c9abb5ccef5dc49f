"""Errors raised by the console itself."""

from __future__ import annotations

from ronna_hw.errors import EXIT_USAGE, RonnaError


class PortTaken(RonnaError):
    """Another program is listening on the console's port."""

    code = "CON-001"
    action = "Choose another port, or omit it to use any free port."
    exit_code = EXIT_USAGE


class NothingToShow(RonnaError):
    """The folder contains no run that the console can show."""

    code = "CON-002"
    action = "Give the folder of a run made by this version; ronna-procedure list shows them."
    exit_code = EXIT_USAGE


class UnreliableRun(RonnaError):
    """The run folder is truncated, was altered, or comes from another version."""

    code = "CON-003"
    action = "ronna-procedure verify lists everything."
