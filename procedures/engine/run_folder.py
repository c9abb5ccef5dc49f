"""A run read back from its folder: what the journal says was recorded, held against the records."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from procedures.engine.ancestry import without_ancestors
from procedures.engine.case import Stored
from procedures.engine.step import StepKey
from procedures.journal.journal import Entry, Line
from procedures.journal.results import StepResult
from ronna_hw.config import describe_mistakes
from ronna_hw.evidence.inspection import Inspection, inspected
from ronna_hw.records import BadRecord, OtherVersion, Record
from ronna_hw.wire.room_tasks import INSERT

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

    @property
    def name(self) -> str:
        """That the run was begun with; its folder may have another one by now."""
        return str(self.opened.get("run") or self.path.resolve().name)

    def lines(self, entry: Entry) -> tuple[Line, ...]:
        """The journal's lines of one kind."""
        return tuple(line for line in self.journal if line["entry"] == entry)

    @property
    def what_stands(self) -> tuple[Record, ...]:
        """The records that nothing superseded, in order."""
        return tuple(record for record in self.records if record.identifier not in self.superseded)

    @property
    def past(self) -> frozenset[str]:
        """Identifiers of results of finished trajectories that were made before something moved."""
        return without_ancestors(self.what_stands)

    def standing(self, model: type[R]) -> tuple[Stored[R], ...]:
        """The valid results of a step, in order. Raises REC-001, REC-003."""
        return _as(model, self.what_stands)

    def made(self, model: type[R]) -> tuple[Stored[R], ...]:
        """All results of a step, in order. Raises REC-001, REC-003."""
        return _as(model, self.records)


def step_key(line: Line) -> StepKey:
    """Return the step that a journal line is about."""
    name, _, trajectory = str(line.get("step", "")).partition(":")
    return StepKey(name, trajectory or None)


def targets_in_doubt(journal: Iterable[Line]) -> dict[str, tuple[str, ...]]:
    """Targets that may be off by more than was predicted, and why; until an instrument goes in once more."""
    doubts: dict[str, tuple[str, ...]] = {}
    for line in journal:
        if line["entry"] == Entry.STAGE and line.get("task") == INSERT and line.get("done") is False:
            doubts.pop(str(line["trajectory"]), None)
        elif line["entry"] == Entry.FINDING and isinstance(targets := line.get("targets"), list):
            for name in map(str, targets):
                doubts[name] = (*doubts.get(name, ()), str(line.get("text")))
    return doubts


def read_run(folder: Path) -> RunFolder:
    """Read a run; raises PRO-033 for one that was changed."""
    return run_of(inspected(folder).require_unchanged())


def run_of(found: Inspection) -> RunFolder:
    """What was found of a run."""
    return RunFolder(found.folder, found.chain.lines, found.records, found.superseded)


def _as(model: type[R], records: Iterable[Record]) -> tuple[Stored[R], ...]:
    return tuple(Stored(record, typed(record, model)) for record in records if record.kind == model.kind)


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
