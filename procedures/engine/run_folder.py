"""A run read back from its folder: what the journal says was recorded, held against the records."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from procedures.engine.case import RECORDS_FOLDER, Stored
from procedures.engine.errors import JournalCorrupt
from procedures.engine.journal import JOURNAL_FILE, Entry, Line, read_journal
from procedures.engine.result import StepResult
from ronna_hw.config import describe_mistakes
from ronna_hw.records import BadRecord, OtherVersion, Record, read_record

R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class RunFolder:
    """The journal, the records that it names in their order, and which of them were superseded."""

    path: Path
    journal: tuple[Line, ...]
    records: tuple[Record, ...]
    superseded: frozenset[str]  # identifiers

    @property
    def opened(self) -> Line:
        """The first line: theatre, banner, strategy, seed. Empty when there is none."""
        return self.journal[0] if self.journal else {}

    def lines(self, entry: Entry) -> tuple[Line, ...]:
        """The journal's lines of one kind."""
        return tuple(line for line in self.journal if line["entry"] == entry)

    def standing(self, model: type[R]) -> tuple[Stored[R], ...]:
        """The results of a step that stand, in order. Raises REC-001, REC-003."""
        return tuple(
            Stored(record, typed(record, model))
            for record in self.records
            if record.kind == model.kind and record.identifier not in self.superseded
        )

    def find(self, model: type[R]) -> R | None:
        """The result of a step that is done once, if it stands. Raises REC-001, REC-003."""
        found = self.standing(model)
        return found[-1].result if found else None


def read_run(folder: Path) -> RunFolder:
    """Read a run. Raises PRO-011 for a broken journal, REC-001 for a record that is missing or changed."""
    return run_of(folder, tuple(read_journal(folder / JOURNAL_FILE)))


def run_of(folder: Path, journal: tuple[Line, ...]) -> RunFolder:
    """A run by the lines of its journal. Raises REC-001 for a record that is missing or changed."""
    results = [line for line in journal if line["entry"] == Entry.RESULT]
    superseded = frozenset(name for line in journal for name in _texts(line, "supersedes"))
    return RunFolder(folder, journal, tuple(_named_by(line, folder) for line in results), superseded)


def typed(record: Record, model: type[R]) -> R:
    """A record's payload as its model. Raises REC-003 for another version, REC-001 for another form."""
    if record.version != model.version:
        raise OtherVersion(
            f"{record.identifier} has another version",
            expected=f"{model.kind} version {model.version}",
            got=f"version {record.version}",
        )
    try:
        return model.model_validate_json(json.dumps(record.payload))
    except ValidationError as error:
        mistakes = "; ".join(describe_mistakes(error))
        raise BadRecord(f"{record.identifier} is not a {model.kind}: {mistakes}") from error


def _named_by(line: Line, folder: Path) -> Record:
    path = folder / RECORDS_FOLDER / f"{_text(line, 'record')}.json"
    if not path.exists():
        raise BadRecord(f"{path.name} is missing: the journal names it")
    record = read_record(path)
    named = _text(line, "sha256")
    if record.sha256 != named:
        raise BadRecord(
            f"{path.name} is not the record that the journal names",
            expected=named[:12],
            got=record.sha256[:12],
        )
    return record


def _text(line: Line, key: str) -> str:
    value = line.get(key)
    if not isinstance(value, str):
        raise JournalCorrupt(f"line {line.get('sequence')} of {JOURNAL_FILE} has no {key}")
    return value


def _texts(line: Line, key: str) -> tuple[str, ...]:
    values = line.get(key, ())
    return tuple(str(value) for value in values) if isinstance(values, list) else ()
