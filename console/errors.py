"""What can go wrong with the console itself."""

from __future__ import annotations

from ronna_hw.errors import EXIT_USAGE, RonnaError


class PortTaken(RonnaError):
    """Another program listens at the console's port."""

    code = "CON-001"
    action = "Choose another port, or leave it out: any free one is taken."
    exit_code = EXIT_USAGE


class NothingToShow(RonnaError):
    """A folder holds no run that the console can show."""

    code = "CON-002"
    action = "Give the folder of a run of this version; ronna-procedure list names them."
    exit_code = EXIT_USAGE
