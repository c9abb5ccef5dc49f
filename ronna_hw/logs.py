"""JSON Lines logging with the device, engine or command of each event.

A part gets its logger once and logs events of interest to a lab: state changes, identities, retries, faults.
Nothing appears anywhere until a command shows the log (`--verbose`) or a run keeps it
(`ronna_hw.log_output`). Never log in a real-time process: the robot link's loop and the camera reception have
no logger.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cached_property
from typing import Any

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
ALL = "ronna"  # the logger above all of ours
PARTS = (
    "dicom",
    "engine",
    "events",
    "flight log",
    "flight recorder",
    "live feed",
    "log",
    "reading tape",
)  # no devices, no processes
TABLES = ("device", "robot", "stereo", "tracker")  # of the theatre file, which names devices
LONGEST_NAME = 200
PROGRAMS = "ronna-"  # prefix of every command and process

logging.getLogger(ALL).addHandler(logging.NullHandler())  # a script that sets up no logging sees nothing


class Logger:
    """structlog logger with bound names; structlog is imported at the first logged event."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = dict(names)
        self._channel_name = logging.getLogger(_channel_name(".".join((ALL, *names.values()))))

    def debug(self, event: str, **facts: Any) -> None:
        """Log debugging details."""
        self._log(logging.DEBUG, event, facts)

    def info(self, event: str, **facts: Any) -> None:
        """Log a state change, an identity or a configuration."""
        self._log(logging.INFO, event, facts)

    def warning(self, event: str, **facts: Any) -> None:
        """Log a loss, retry or recovery after which work continues."""
        self._log(logging.WARNING, event, facts)

    def error(self, event: str, **facts: Any) -> None:
        """Log a fault that ended the current work."""
        self._log(logging.ERROR, event, facts)

    def _log(self, level: int, event: str, facts: dict[str, Any]) -> None:
        if self._channel_name.isEnabledFor(level):
            getattr(self._bound, logging.getLevelName(level).lower())(event, **facts)

    @cached_property
    def _bound(self) -> Any:
        import structlog

        from ronna_hw.redaction import redact_event

        return structlog.wrap_logger(
            self._channel_name,
            processors=[
                structlog.processors.TimeStamper(fmt="iso", utc=True),
                structlog.stdlib.add_log_level,
                redact_event,
                structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
            ],
            wrapper_class=structlog.stdlib.BoundLogger,
        ).bind(**self._names)


def logger(**names: str) -> Logger:
    """Return a logger with bound names: `logger(device="tracker")`, `logger(part="engine")`.

    The names are in each of its lines; levels are set for their values, joined by dots: `engine` covers
    `engine.registration`, and `ronna-sim` the process `ronna-sim polaris`.
    """
    return Logger(names)


def list_loggers() -> tuple[str, ...]:
    """List the permitted first parts of logger names."""
    return (*sorted((*PARTS, *TABLES)), f"{PROGRAMS}COMMAND")


def is_known_logger(name: str) -> bool:
    """Return whether loggers with this name, or below it, can exist."""
    if len(name) > LONGEST_NAME:  # each part of it would get a logger of its own
        return False
    first = name.split(".")[0]
    parts = (part for known in PARTS for part in (known, _channel_name(known).split(".")[0]))
    return first in (*parts, *TABLES) or first.startswith(PROGRAMS)


def _channel_name(name: str) -> str:
    return name.replace(" ", ".")


def set_level(level: str, name: str = "") -> None:
    """Set the lowest level to log (`debug`, `info`, `warning`, `error`), for one logger or all.

    Raises ValueError for any other word.
    """
    if level not in LEVELS:
        raise ValueError(f"expected a level ({', '.join(LEVELS)}), got {level!r}")
    logging.getLogger(_channel_name(f"{ALL}.{name}") if name else ALL).setLevel(LEVELS[level])
