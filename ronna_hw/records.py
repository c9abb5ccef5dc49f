"""Immutable result records, each with an identifier and its parents.

If one changes, everything after it is invalid. A record's hash covers all of it: its content and parents, the
run, series and trajectory it belongs to, its own identifier and its date. So no record can stand in for
another, not even for one with the same content.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input import LARGEST_JSON_BYTES, MOST_VALUES, parse_json, read_bounded, read_json_bytes
from ronna_hw.errors import DataError, ErrorCode

PARTIAL = ".partial"  # suffix of a file's name while it is written


class BadRecord(DataError):
    """A stored record is missing, incomplete, or does not match its hash."""

    code = "REC-001"
    action = "Do not use this result; repeat the step that made it."


RECORD_EXISTS = ErrorCode(
    "REC-002",
    DataError,
    "A record with this identifier already exists; identifiers are never reused.",
    "Keep the folder as it is, and start a new run.",
)


OTHER_VERSION = ErrorCode(
    "REC-003",
    DataError,
    "A record was written by a program version with different field meanings.",
    "Read it with the version that wrote it, or repeat the step.",
)


@dataclass(frozen=True)
class Record:
    """Result record: `kind` is its type, `parents` maps parent identifiers to hashes.

    `series` is the DICOM UID of the CT that the case is based on.
    """

    identifier: str
    kind: str
    parents: Mapping[str, str]
    payload: Mapping[str, Any]
    version: int = 1
    run: str = ""
    series: str | None = None
    trajectory: str | None = None
    created: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))

    @property
    def sha256(self) -> str:
        """Hash of the entire record."""
        return hashlib.sha256(canonical_json(vars(self))).hexdigest()


FILE_FIELDS = frozenset(record_field.name for record_field in fields(Record)) | {"parents_sha256", "sha256"}


def canonical_json(content: Any) -> bytes:
    """Encode content in canonical form: sorted keys, no whitespace, no NaN."""
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def write_record(record: Record, folder: Path) -> Path:
    """Write `<identifier>.json` atomically; raises REC-002 if the record exists."""
    path = folder / f"{record.identifier}.json"
    try:
        write_atomically(path, _encode_record(record), exclusive=True)
    except FileExistsError as error:
        raise RECORD_EXISTS(f"{path.name} already exists") from error
    return path


def file_sha256(record: Record) -> str:
    """Return the hash of the file written by `write_record`."""
    return hashlib.sha256(_encode_record(record)).hexdigest()


def is_stored(path: Path, sha256: str) -> bool:
    """Return whether a record file exists with the given hash; cheaper than reading it back."""
    try:
        found = read_bounded(path, LARGEST_JSON_BYTES, follow_links=False)
    except (OSError, ValueError):
        return False
    return hashlib.sha256(found).hexdigest() == sha256


def _encode_record(record: Record) -> bytes:
    return "".join(_iterate_encoded(record)).encode()


def _iterate_encoded(record: Record) -> Iterator[str]:
    """Yield a record file's canonical content in parts."""
    content = {
        **vars(record),
        "parents": list(record.parents),
        "parents_sha256": list(record.parents.values()),
    }
    return json.JSONEncoder(indent=1, allow_nan=False).iterencode({**content, "sha256": record.sha256})


def write_atomically(path: Path, content: bytes, *, exclusive: bool = False, flushed: bool = True) -> None:
    """Write a file atomically, so that it is never seen half written, even after a crash.

    With `exclusive` an existing file is never replaced: raises FileExistsError. A file that is worthless
    without others need not be `flushed` to the disk. A system error names the file, or its missing folder.
    """
    temporary = path.with_name(f".{path.name}{PARTIAL}")
    try:
        temporary.unlink(missing_ok=True)  # of a program that was killed, or somebody's link to another file
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            if flushed:
                os.fsync(file.fileno())
        if exclusive:
            os.link(temporary, path)
            temporary.unlink()
        else:
            temporary.replace(path)
    except BaseException as problem:  # even an interrupted flush leaves nothing half written
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(problem, OSError):
            no_folder = isinstance(problem, FileNotFoundError | NotADirectoryError)
            error_path = str(path.parent if no_folder else path)
            raise OSError(problem.errno, problem.strerror, error_path) from problem  # not the temporary one
        raise


def read_record(path: Path) -> Record:
    """Read a record and verify its hash and exact byte form; raises REC-001."""
    try:
        found = read_json_bytes(path, most_values=MOST_VALUES, follow_links=False)
        content = parse_json(found)
        if not isinstance(content, dict):
            raise ValueError("it is no JSON object")
        if different := content.keys() ^ FILE_FIELDS:
            name = min(different)
            raise ValueError(f"it has {'an unknown field' if name in content else 'no'} {name!r}")
        claimed = content.pop("sha256")
        parents = dict(zip(content.pop("parents"), content.pop("parents_sha256"), strict=True))
        record = Record(**content, parents=parents)
        sha256 = record.sha256
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise BadRecord(f"{path.name} is not a record: {error}") from error
    if sha256 != claimed:
        raise BadRecord(f"{path.name} does not match its hash", got=sha256[:12], expected=str(claimed)[:12])
    if not _has_canonical_form(found, record):
        raise BadRecord(f"{path.name} was rewritten: same content, different bytes")
    return record


def _has_canonical_form(found: bytes, record: Record) -> bool:
    """Return whether a record file is in canonical form, comparing in parts up to the first difference."""
    at = 0
    for part in _iterate_encoded(record):
        if not found.startswith(part.encode(), at):
            return False
        at += len(part)
    return at == len(found)
