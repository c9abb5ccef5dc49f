"""Inbox of received series: a folder for each, named by ourselves, with its slices and its record.

No name in it comes from outside, and no record in it has a word about the patient.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ValidationError

from procedures.exchange.dicom_network.errors import NOT_IN_INBOX
from procedures.imaging.dicom.slice_headers import CT_FOLDER
from ronna_hw.bounded_input import InputRefused, read_json_bytes
from ronna_hw.records import write_atomically

RECORD_FILE = "series.json"  # written by the receiver alone
TAKEN_FILE = "taken.json"  # a copy of the record, by which a case took the series
NAME_DIGITS = 12  # of SHA-256: two series that share it are told apart by their records
SLICE_DIGITS = 32


class SeriesState(StrEnum):
    """How far a series of the inbox has come."""

    ARRIVING = "arriving"  # or known to lack slices
    COMPLETE = "complete"  # the source has as many
    UNKNOWN = "unknown"  # quiet, but nobody said how many there are
    TAKEN = "taken"  # by a case, as it is now


class Extent(BaseModel, frozen=True, extra="forbid"):
    """Space that the slices of a series cover, LPS in mm, and the distance between them."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    spacing_mm: float


class ReceivedSeries(BaseModel, frozen=True, extra="forbid"):
    """Record of a series as far as it has arrived."""

    series_instance_uid: str
    study_instance_uid: str
    caller: str  # AE title of its last sender, which nobody has proved without TLS
    state: SeriesState = SeriesState.ARRIVING
    instances: int = 0
    expected: int | None = None  # by its source
    reason: str = ""  # why it is not complete
    extent: Extent | None = None
    problem: str = ""  # that a case would refuse: code and words
    first_arrival: datetime
    last_arrival: datetime

    @property
    def complete(self) -> bool | Literal["unknown"]:
        """Whether all slices have arrived, as far as anybody can say."""
        if self.expected is None or self.instances > self.expected:
            return "unknown"
        return self.instances == self.expected


@dataclass(frozen=True)
class InboxEntry:
    """A series of the inbox: its name, folder and record, with the state that counts."""

    folder: Path
    record: ReceivedSeries
    state: SeriesState

    @property
    def name(self) -> str:
        """Name by which a person takes it."""
        return self.folder.name

    @property
    def slices(self) -> Path:
        """Folder of its DICOM files."""
        return self.folder / CT_FOLDER

    def as_dict(self) -> dict[str, object]:
        """Return it as plain data for JSON."""
        known = self.record.model_dump(mode="json")
        return {"name": self.name, **known, "state": str(self.state), "complete": self.record.complete}


def name_series(series_uid: str) -> str:
    """Return the name of a series' folder."""
    return hashlib.sha256(series_uid.encode()).hexdigest()[:NAME_DIGITS]


def name_slice(instance_uid: str) -> str:
    """Return the file name of an object; the same object gets the same name."""
    return f"{hashlib.sha256(instance_uid.encode()).hexdigest()[:SLICE_DIGITS]}.dcm"


def write_record(folder: Path, record: ReceivedSeries) -> None:
    """Write the record of a series into its folder."""
    write_atomically(folder / RECORD_FILE, record.model_dump_json(indent=1).encode())


def mark_taken(entry: InboxEntry) -> None:
    """Note that a case has taken a series as it is now."""
    write_atomically(entry.folder / TAKEN_FILE, entry.record.model_dump_json(indent=1).encode())


def list_series(inbox: Path) -> list[InboxEntry]:
    """List all series of an inbox, the oldest first."""
    return sorted(_iterate(inbox), key=lambda one: (one.record.first_arrival, one.name))


def find_series(inbox: Path, name: str) -> InboxEntry:
    """Return the series whose name begins so, or that has this Series Instance UID. Raises DCM-011."""
    entries = list_series(inbox)
    found = [
        one
        for one in entries
        if name and (one.name.startswith(name) or one.record.series_instance_uid == name)
    ]
    if len(found) != 1:
        words = f"{len(found)} series of {inbox} are named {name!r}"
        raise NOT_IN_INBOX(words, expected="one of " + (", ".join(one.name for one in entries) or "none"))
    return found[0]


def _iterate(inbox: Path) -> Iterator[InboxEntry]:
    for folder in inbox.iterdir() if inbox.is_dir() else ():
        if (record := _read(folder / RECORD_FILE)) is not None:
            taken = _read(folder / TAKEN_FILE) == record
            yield InboxEntry(folder, record, SeriesState.TAKEN if taken else record.state)


def _read(path: Path) -> ReceivedSeries | None:
    """Read a record; None if there is none that is readable, as in a folder of something else."""
    try:
        return ReceivedSeries.model_validate_json(read_json_bytes(path))
    except (OSError, InputRefused, ValidationError):
        return None
