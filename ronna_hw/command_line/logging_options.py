"""A command's log output and its levels: `--verbose`, `--log-level`, `RONNA_LOG`."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import RonnaError
from ronna_hw.logs import Logger, is_known, known_loggers, logger, set_level

LEVELS_VARIABLE = "RONNA_LOG"
VERBOSE_FLAG = "--verbose"


def set_log_levels(levels: Sequence[str]) -> None:
    """Apply levels such as `debug` (every logger) or `tracker=debug` (one); raises CLI-001."""
    for entry in levels:
        name, _, level = entry.strip().rpartition("=")
        if name and not is_known(name):
            raise UsageMistake(
                f"log level {entry!r}: nothing logs as {name!r}", expected=", ".join(known_loggers())
            )
        try:
            set_level(level.lower(), name)
        except ValueError as wrong:
            raise UsageMistake(f"log level {entry!r}: {wrong}") from wrong


def set_log_levels_by_option(levels: Sequence[str] | None) -> None:
    """Apply them, also in every process that this command starts or becomes; raises CLI-001."""
    if not levels:
        return
    set_log_levels(levels)
    before = os.environ.get(LEVELS_VARIABLE)
    os.environ[LEVELS_VARIABLE] = ",".join((*([before] if before else []), *levels))


def set_log_levels_from_environment() -> None:
    """Apply the levels in RONNA_LOG, separated by commas; options are applied later and take precedence."""
    given = os.environ.get(LEVELS_VARIABLE)
    if given:
        set_log_levels(given.split(","))


def set_up_logging(verbose: bool) -> None:
    """Show the log on standard error with `--verbose`; otherwise silence warnings from libraries.

    Python would print those warnings among the command's messages.
    """
    if not verbose:
        logging.getLogger().addHandler(logging.NullHandler())
        warnings.simplefilter("ignore")
        return
    from ronna_hw.log_output import about_this_computer, show_log

    show_log(sys.stderr)
    command_logger().info("started", **about_this_computer())


def command_logger() -> Logger:
    """The logger of this process' command."""
    return logger(command=Path(sys.argv[0]).name)


def log_failure(problem: Exception, error: RonnaError) -> None:
    """Log how a command failed: the error, and where it was raised, without any values."""
    import traceback

    frames = traceback.extract_tb(problem.__traceback__)
    raised_at = [f"{Path(frame.filename).name}:{frame.lineno}" for frame in frames]
    command_logger().error("failed", error=error, raised_by=type(problem).__name__, trace=raised_at)
