"""Redaction of log lines: no patient data, secrets or identifying paths.

Redaction prefers removing too much. Text is kept only if it cannot come from a patient's files: an error
about a CT, a plan or a file is logged by its code alone, and so is every library exception.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, MutableMapping, Sequence, Sized
from itertools import islice
from pathlib import PurePath
from typing import Any

from ronna_hw.errors import (
    ConfigurationError,
    ConnectError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    RonnaError,
    StateError,
)
from ronna_hw.text import escape_controls

REDACTED = "[redacted]"
TEXT_LIMIT = 1000  # characters of one value: a line stays a line
ELEMENTS_LIMIT = 50  # of one sequence or mapping

# Their text is about devices, limits and configuration. A DataError quotes the patient's files.
_LOGGED_IN_FULL = (
    ConfigurationError,
    ConnectError,
    DeviceError,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    StateError,
)
# They name trajectories, and a trajectory may be named after the patient; their words are in the journal.
_CODES_WITH_TRAJECTORIES = ("PLAN-", "PRO-", "TOOL-001")
_PATIENT_KEY = re.compile(
    r"patient|birth|accession|institution|physician|operator|person|acknowledged|confirmed_by|token|secret",
    re.IGNORECASE,
)
_TOKEN = re.compile(r"(token=)[^&\s'\"]+", re.IGNORECASE)
_UID = re.compile(r"\b\d+(?:\.\d+){5,}\b")
# The patterns below begin only where a word does: from each of its letters, a long one would cost its square.
_CUT_WORD = re.compile(r"(?<!\S)\S*+\Z")
# A word with a slash is a path, unless it is an endpoint, a device node, or a unit such as mm/s.
_WORD_WITH_SLASH = re.compile(r"(?<![^\s'\"(),;=])[^\s'\"(),;=/]*+/[^\s'\"(),;]*+")
_HARMLESS_SLASH = re.compile(
    r"(?:udp|tcp|serial|gev|shm|host):[\w.:\[\]%?&=/-]*"
    r"|/dev/[\w/.-]+"
    r"|(?:[\d.%]+|mm|rad|deg|px|bytes|frames)?/(?:s[²³]?|mm|px|min|[\d.]+)"
)
_FILE_NAME = re.compile(r"(?<![^\s'\"/])[^\s'\"/]+\.(?:dcm|ima|nii|gz|toml|jsonl?|csv|html)\b", re.IGNORECASE)


def redact_event(_log: object, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Remove all personal or secret data from an event, as a structlog processor."""
    return {key: redact_value(key, value) for key, value in event.items()}


def redact_value(key: str, value: Any) -> Any:
    """Redact a value for the log: numbers unchanged, text scrubbed, errors by `error_text`."""
    if _PATIENT_KEY.search(key):
        return REDACTED
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)  # JSON has no NaN
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, BaseException):
        return error_text(value)
    if isinstance(value, PurePath):
        return REDACTED if not str(value).startswith("/dev/") else str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        items = islice(value.items(), ELEMENTS_LIMIT)
        kept = {str(inner): redact_value(str(inner), item) for inner, item in items}
        return kept | {"...": _describe_rest(value)} if len(value) > ELEMENTS_LIMIT else kept
    if isinstance(value, Sequence | set | frozenset) and not isinstance(value, str | bytes):
        first = [redact_value(key, item) for item in islice(value, ELEMENTS_LIMIT)]
        return [*first, _describe_rest(value)] if len(value) > ELEMENTS_LIMIT else first
    if isinstance(value, bytes):
        return value[:TEXT_LIMIT].hex(" ")
    return scrub_text(str(value))


def _describe_rest(value: Sized) -> str:
    return f"{len(value) - ELEMENTS_LIMIT} more"


def scrub_text(text: str) -> str:
    """Remove tokens, DICOM UIDs, paths and file names from text; endpoints and device nodes are kept.

    Of a text beyond the limit only what will be logged is looked at, without the word that the limit cuts.
    """
    if len(text) > TEXT_LIMIT:
        text = _CUT_WORD.sub(REDACTED, text[:TEXT_LIMIT])
    text = _TOKEN.sub(rf"\1{REDACTED}", text)
    text = _WORD_WITH_SLASH.sub(_redact_path, text)
    text = _FILE_NAME.sub(REDACTED, text)
    return escape_controls(_UID.sub(REDACTED, text)[:TEXT_LIMIT])


def error_text(error: BaseException) -> str:
    """Return an error's text if it concerns a device, a limit or the theatre, otherwise its code or type."""
    code = error.code if isinstance(error, RonnaError) else ""
    if isinstance(error, _LOGGED_IN_FULL) and not code.startswith(_CODES_WITH_TRAJECTORIES):
        return scrub_text(str(error))
    return code or type(error).__name__


def redact_arguments(arguments: Sequence[str]) -> list[str]:
    """Redact a command line except for subcommand, options, numbers and endpoints."""
    if arguments and re.fullmatch(r"[a-z-]+", arguments[0]):
        return [arguments[0], *map(_argument, arguments[1:])]
    return [_argument(item) for item in arguments]


def _argument(argument: str) -> str:
    option, equals, value = argument.partition("=")
    if option.startswith("-") and (equals or not _is_number(option)):
        return f"{option}={_argument(value)}" if equals else option
    if _is_number(argument):
        return argument
    return scrub_text(argument) if re.match(r"[a-z]+:", argument) else REDACTED


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _redact_path(found: re.Match[str]) -> str:
    word = found.group()
    return word if _HARMLESS_SLASH.fullmatch(word.rstrip(".:")) else REDACTED
