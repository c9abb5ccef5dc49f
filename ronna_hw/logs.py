"""Logs: one JSON line per event, with the name of the device, engine or command that says it.

A part asks for its logger once and logs what a lab would ask about: state changes, identities, retries,
faults. Nothing appears anywhere until a command shows the log (`--verbose`) or a run keeps it (`keep_log`).
Never log in a real-time process: the robot link's loop and the camera reception have no logger.
"""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
import platform
import re
import sys
import warnings
from collections.abc import Iterator, Mapping, MutableMapping
from functools import cached_property
from pathlib import Path
from typing import Any, TextIO

from ronna_hw.redaction import REDACTED, redact_event, redacted_arguments, scrubbed

LOG_FILE = "log.jsonl"
FILE_BYTES = 1_000_000
OLD_FILES = 3  # log.jsonl.1 to .3: a run keeps at most four megabytes
LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}

_ROOT = "ronna"
_READ_PATIENT_FILES = ("pydicom", "pynetdicom", "highdicom", "gdcm")
_WARNING_PLACE = re.compile(r"\w+\.py:\d+: \w+")  # series.py:52: UserWarning
_VERSIONS_TOLD = (
    "ronna-hw",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "pydicom",
    "pyserial",
    "pin",
)

logging.getLogger(_ROOT).addHandler(logging.NullHandler())  # a script that sets up no log sees none


class Logger:
    """A structlog logger with names bound. structlog is imported with the first event that is wanted."""

    def __init__(self, names: Mapping[str, str]) -> None:
        self._names = dict(names)
        self._channel = logging.getLogger(".".join((_ROOT, *names.values())).replace(" ", "."))

    def debug(self, event: str, **facts: Any) -> None:
        """Detail for the one who looks for a fault."""
        self._log(logging.DEBUG, event, facts)

    def info(self, event: str, **facts: Any) -> None:
        """What happened: a change of state, an identity, a configuration."""
        self._log(logging.INFO, event, facts)

    def warning(self, event: str, **facts: Any) -> None:
        """Something was lost, retried or recovered, and work goes on."""
        self._log(logging.WARNING, event, facts)

    def error(self, event: str, **facts: Any) -> None:
        """A fault: work stopped here."""
        self._log(logging.ERROR, event, facts)

    def _log(self, level: int, event: str, facts: dict[str, Any]) -> None:
        if self._channel.isEnabledFor(level):
            self._bound.log(level, event, **facts)

    @cached_property
    def _bound(self) -> Any:
        import structlog

        return structlog.wrap_logger(
            self._channel,
            processors=[
                structlog.processors.TimeStamper(fmt="iso", utc=True),
                structlog.stdlib.add_log_level,
                redact_event,
                structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
            ],
            wrapper_class=structlog.stdlib.BoundLogger,
        ).bind(**self._names)


def logger(**names: str) -> Logger:
    """The logger of one part: `logger(device="tracker")`, `logger(part="engine", step="registration")`.

    The names are in each of its lines; their values, joined by dots, are what a level is set for: `engine`
    covers `engine.registration`, and `ronna-sim` the process `ronna-sim polaris`.
    """
    return Logger(names)


def set_level(level: str, name: str = "") -> None:
    """Log only this level (`debug`, `info`, `warning`, `error`) and above, for one logger or for all.

    Raises ValueError for another word.
    """
    if level not in LEVELS:
        raise ValueError(f"expected a level ({', '.join(LEVELS)}), got {level!r}")
    logging.getLogger(f"{_ROOT}.{name}" if name else _ROOT).setLevel(LEVELS[level])


def show_log(stream: TextIO) -> None:
    """Write the log to a stream for the rest of the process, one readable line per event."""
    import structlog

    _attach(logging.StreamHandler(stream), structlog.dev.ConsoleRenderer(colors=False))
    logging.captureWarnings(True)


def ignore_libraries() -> None:
    """Silence the warnings of libraries; without this Python prints them on standard error."""
    logging.getLogger().addHandler(logging.NullHandler())
    warnings.simplefilter("ignore")


@contextlib.contextmanager
def keep_log(folder: Path, **facts: Any) -> Iterator[None]:
    """Keep the log in `folder/log.jsonl` inside the block: rotated, bounded, closed at the end.

    It begins with versions and platform; `facts` are added to that line. A full disk loses lines of the log
    and stops nothing.
    """
    import structlog

    handler = _attach(
        _BoundedFile(
            folder / LOG_FILE, maxBytes=FILE_BYTES, backupCount=OLD_FILES, encoding="utf-8", delay=True
        ),
        structlog.processors.JSONRenderer(default=str),
    )
    try:
        logger(part="log").info("opened", **about_this_computer(), **facts)
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()


def about_this_computer() -> dict[str, Any]:
    """Versions, platform and the command as it was called, redacted: how a question to the authors begins."""
    from importlib import metadata

    versions = {}
    for package in _VERSIONS_TOLD:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return {
        "versions": versions,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "command": Path(sys.argv[0]).name,
        "arguments": redacted_arguments(sys.argv[1:]),
    }


class _BoundedFile(logging.handlers.RotatingFileHandler):
    """A rotating file that a full disk may damage, but that never stops the run it is about."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Lose the line: the journal, not the log, is what a run depends on."""

    def close(self) -> None:
        with contextlib.suppress(OSError):
            super().close()


def _attach(handler: logging.Handler, renderer: Any) -> logging.Handler:
    """Put a handler at the root, where the lines of libraries arrive as well as ours."""
    import structlog

    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[
                structlog.processors.TimeStamper(fmt="iso", utc=True),
                structlog.stdlib.add_log_level,
                _redact_library,
            ],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, _event_first, renderer],
        )
    )
    logging.getLogger().addHandler(handler)
    ours = logging.getLogger(_ROOT)
    if ours.level == logging.NOTSET:
        ours.setLevel(logging.INFO)
    return handler


def _event_first(_log: object, _method: str, event: MutableMapping[str, Any]) -> dict[str, Any]:
    return {key: event[key] for key in ("timestamp", "level", "event")} | dict(event)


def _redact_library(_log: object, _method: str, event: MutableMapping[str, Any]) -> dict[str, Any]:
    """A library's own line. Of a warning the place is kept; of what reads the patient's files, no text."""
    record: logging.LogRecord = event["_record"]
    text = str(event["event"])
    if record.name == "py.warnings":
        place = _WARNING_PLACE.search(text)
        text = place.group() if place else REDACTED
    elif record.name.split(".")[0] in _READ_PATIENT_FILES:
        text = REDACTED
    else:
        text = scrubbed(text)
    event.pop("exc_info", None)  # a trace shows local values
    return {**event, "library": record.name, "event": text}
