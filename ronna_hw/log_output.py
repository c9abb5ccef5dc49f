"""Log output: lines on a stream, or a rotated `log.jsonl`; of libraries' messages without values."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
import platform
import re
import sys
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any, TextIO

from ronna_hw.logs import ALL, logger
from ronna_hw.redaction import REDACTED, redact_arguments, scrub_text

LOG_FILE = "log.jsonl"
FILE_BYTES = 1_000_000
OLD_FILES = 3  # log.jsonl.1 to .3: a run keeps at most four megabytes

_PATIENT_FILE_LIBRARIES = ("pydicom", "pynetdicom", "highdicom", "gdcm")
_WARNING_PLACE = re.compile(r"\b\w++\.py:\d+: \w+")  # series.py:52: UserWarning
_VERSIONS_LOGGED = (
    "ronna-hw",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
    "pydicom",
    "pyserial",
    "pin",
)


def show_log(stream: TextIO) -> None:
    """Write the log to a stream for the rest of the process, one readable line per event."""
    import structlog

    _attach(_StreamOutput(stream), structlog.dev.ConsoleRenderer(colors=False))
    logging.captureWarnings(True)


@contextlib.contextmanager
def keep_log(folder: Path, **facts: Any) -> Iterator[None]:
    """Write the log to `folder/log.jsonl` during the block, with rotation and a size limit.

    It begins with versions and platform; `facts` are added to that line. A full disk loses log
    lines and stops nothing.
    """
    import structlog

    handler = _attach(
        _BoundedFile(
            folder / LOG_FILE, maxBytes=FILE_BYTES, backupCount=OLD_FILES, encoding="utf-8", delay=True
        ),
        structlog.processors.JSONRenderer(default=str),
    )
    try:
        logger(part="log").info("opened", **describe_computer(), **facts)
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        handler.close()


def describe_computer() -> dict[str, Any]:
    """Describe versions, platform and the redacted command line for support requests."""
    from importlib import metadata

    versions = {}
    for package in _VERSIONS_LOGGED:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return {
        "versions": versions,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "command": Path(sys.argv[0]).name,
        "arguments": redact_arguments(sys.argv[1:]),
    }


class _TolerantHandler(logging.Handler):
    """Log handler that drops lines rejected by a full disk or a closed pipe; a run needs only its journal."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Drop the line."""


class _StreamOutput(_TolerantHandler, logging.StreamHandler[TextIO]):
    """Handler for standard error."""


class _BoundedFile(_TolerantHandler, logging.handlers.RotatingFileHandler):
    """Handler for a rotated, size-limited file."""

    def close(self) -> None:
        with contextlib.suppress(OSError):
            super().close()


def _attach(handler: logging.Handler, renderer: Any) -> logging.Handler:
    """Attach a handler to the root logger, which also receives library log lines."""
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
    ours = logging.getLogger(ALL)
    if ours.level == logging.NOTSET:
        ours.setLevel(logging.INFO)
    return handler


def _event_first(_log: object, _method: str, event: MutableMapping[str, Any]) -> dict[str, Any]:
    return {key: event[key] for key in ("timestamp", "level", "event")} | dict(event)


def _redact_library(_log: object, _method: str, event: MutableMapping[str, Any]) -> dict[str, Any]:
    """Redact a log line from a library.

    Warnings keep their location; libraries that read patient files keep no text.
    """
    record: logging.LogRecord = event["_record"]
    text = str(event["event"])
    if record.name == "py.warnings":
        place = _WARNING_PLACE.search(text)
        text = place.group() if place else REDACTED
    elif record.name.split(".")[0] in _PATIENT_FILE_LIBRARIES:
        text = REDACTED
    else:
        text = scrub_text(text)
    event.pop("exc_info", None)  # a traceback shows local values
    return {**event, "library": record.name, "event": text}
