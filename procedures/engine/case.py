"""Valid and superseded results of one run, stored as immutable records that reference their parents.

RUN/journal.jsonl            intents and outcomes
RUN/records/05-....json      one result each
RUN/theatre/, RUN/case/      inputs that the run brought along
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Generic, TypeVar, cast

from procedures.journal.errors import StepRefused
from procedures.journal.results import StepResult, parse_record
from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.records import BadRecord, Record, file_sha256, is_stored, read_record, write_record

R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class StepKey:
    """Key of a step in a case: step name and optional trajectory."""

    name: str
    trajectory: str | None = None

    def __str__(self) -> str:
        return f"{self.name}:{self.trajectory}" if self.trajectory else self.name


@dataclass(frozen=True)
class Exclusion:
    """A trajectory excluded from the case by a step's result."""

    trajectory: str
    reason: str
    by: StepKey  # the step whose standing result says so; repeated, it may take the trajectory in again


@dataclass(frozen=True)
class Stored(Generic[R]):
    """Stored record with its parsed model."""

    record: Record
    result: R

    @cached_property
    def file_sha256(self) -> str:
        return file_sha256(self.record)


def results_of(model: type[R], records: Iterable[Record]) -> tuple[Stored[R], ...]:
    """Return the results of a step among records, in order, and those that stand in for them.

    Raises REC-001, REC-003.
    """
    models = stand_ins(model)
    return tuple(
        Stored(record, parse_record(record, models[record.kind]))
        for record in records
        if record.kind in models
    )


def stand_ins(model: type[R]) -> Mapping[str, type[R]]:
    """Return a model and those derived from it, whose results stand in for its own, by kind."""
    found = {model.kind: model}
    for derived in model.__subclasses__():
        found |= stand_ins(derived)
    return found


class Case:
    """Run folder with its valid and superseded results."""

    def __init__(self, folder: Path, run: str | None = None) -> None:
        """Open the run folder; `run` is its original name if it was renamed."""
        self.folder = folder
        self.run = run or folder.name
        self._standing: dict[StepKey, Stored[StepResult]] = {}
        self._superseded: list[Record] = []
        self._doubts: dict[str, str] = {}  # identifier of a record -> the fault that came after it
        (folder / RECORDS_FOLDER).mkdir(parents=True, exist_ok=True)
        # Also of records that the journal does not name: an identifier is never used twice.
        number_matches = (re.match(r"\d+", path.name) for path in (folder / RECORDS_FOLDER).iterdir())
        self._written = max((int(found[0]) for found in number_matches if found), default=0)

    def store(self, key: StepKey, result: StepResult, parents: Sequence[Record]) -> Stored[StepResult]:
        """Write a result to a record named by number, kind and trajectory. Raises REC-002.

        It is valid only once accepted, after the journal has it.
        """
        self._written += 1
        named = (stored.result.names_series() for stored in self._standing.values())
        name = "-".join(part for part in (f"{self._written:02d}", key.name, key.trajectory) if part)
        record = Record(
            identifier=name,
            kind=result.kind,
            parents={parent.identifier: parent.sha256 for parent in parents},
            payload=result.model_dump(mode="json", by_alias=True),
            version=result.version,
            run=self.run,
            series=result.names_series() or next(filter(None, named), None),
            trajectory=key.trajectory,
        )
        write_record(record, self.folder / RECORDS_FOLDER)
        return Stored(record, result)

    def records_superseded_by(self, key: StepKey, finished: Collection[str] = ()) -> tuple[Record, ...]:
        """Return the records superseded by a new result of a step: the old result and its descendants.

        Results of `finished` trajectories are never superseded.
        """
        former = self._standing.get(key)
        if former is None:
            return ()
        superseded_identifiers = {former.record.identifier}
        # A result may descend through one that is no longer valid; a parent has the lower number.
        for record in self.records:
            if not superseded_identifiers.isdisjoint(record.parents):
                superseded_identifiers.add(record.identifier)
        standing = (stored.record for stored in self._standing.values())
        gone = (record for record in standing if record.identifier in superseded_identifiers)
        return tuple(record for record in gone if record.trajectory not in finished)

    @property
    def finished_before_move(self) -> frozenset[str]:
        """Identifiers of valid results of finished trajectories whose ancestors are no longer valid."""
        return without_ancestors(stored.record for stored in self._standing.values())

    @property
    def trajectories_finished_before_move(self) -> frozenset[str]:
        """Trajectories finished before a move. Their results stay valid, but no further steps run."""
        past = self.finished_before_move
        named = (one.record for one in self._standing.values() if one.record.identifier in past)
        return frozenset(record.trajectory for record in named if record.trajectory is not None)

    def accept(self, key: StepKey, stored: Stored[StepResult], finished: Collection[str] = ()) -> None:
        """Make a result valid, superseding the results listed by `records_superseded_by`."""
        self.void(key, finished)
        self._standing[key] = stored

    def void(self, key: StepKey, finished: Collection[str] = ()) -> None:
        """Void a step's result and its descendants; see `records_superseded_by`."""
        gone = self.records_superseded_by(key, finished)
        self._superseded += gone
        self._standing = {kept: one for kept, one in self._standing.items() if one.record not in gone}

    def stands(self, key: StepKey) -> bool:
        return key in self._standing

    def record_of(self, key: StepKey) -> str | None:
        """Return the identifier of a step's valid result, or None."""
        return self._standing[key].record.identifier if key in self._standing else None

    def was_superseded(self, key: StepKey) -> bool:
        """Whether all results of a step have been superseded."""
        had_result = any(
            one.kind == key.name and one.trajectory == key.trajectory for one in self._superseded
        )
        return had_result and not self.stands(key)

    def find(self, model: type[R], trajectory: str | None) -> Stored[R] | None:
        """Look up a valid result of a model, first for the trajectory and then for the whole case.

        Without one of its own kind, that of a derived model stands in for it.
        """
        for kind in stand_ins(model):
            for key in (StepKey(kind, trajectory), StepKey(kind)):
                if key in self._standing:
                    return cast("Stored[R]", self._standing[key])
        return None

    def get(self, model: type[R], trajectory: str | None = None) -> Stored[R]:
        """Like `find`, but raises PRO-001 for a missing result and REC-001 for a changed file."""
        stored = self.find(model, trajectory)
        if stored is None:
            where = f" for {trajectory}" if trajectory else ""
            raise StepRefused(f"there is no {model.kind}{where} yet")
        path = self.folder / RECORDS_FOLDER / f"{stored.record.identifier}.json"
        if is_stored(path, stored.file_sha256):
            return stored
        if read_record(path).sha256 != stored.record.sha256:  # it raises if the file is damaged
            raise BadRecord(f"{path.name} is not the record that this run wrote")
        return stored

    def trusts(self, key: StepKey) -> bool:
        """Whether a step has a valid result that is not in doubt."""
        return self.stands(key) and self.doubt_at(key) is None

    def doubt(self, key: StepKey, fault: str) -> None:
        """Mark a step's valid result as doubtful, so that the operator is asked whether to keep it."""
        if key in self._standing:
            self._doubts[self._standing[key].record.identifier] = fault

    def doubt_at(self, key: StepKey) -> str | None:
        """Return the fault that casts doubt on a step's own result, or None."""
        return self._doubts.get(self.record_of(key) or "")

    def doubt_of(self, record: Record) -> str | None:
        """Return the fault that casts doubt on a record or one of its parents, or None."""
        names = (record.identifier, *record.parents)
        return next((self._doubts[name] for name in names if name in self._doubts), None)

    def trust(self, record: Record) -> None:
        """Clear any doubt about a record and its parents."""
        for name in (record.identifier, *record.parents):
            self._doubts.pop(name, None)

    @property
    def left_out(self) -> tuple[Exclusion, ...]:
        """Trajectories excluded by the valid results."""
        return tuple(
            Exclusion(trajectory, reason, key)
            for key, stored in self._standing.items()
            for trajectory, reason in stored.result.leaves_out().items()
        )

    def exclusions_before(self, key: StepKey) -> dict[str, str]:
        """Return the exclusions (trajectory to reason) that do not depend on a step's own result."""
        gone = {(record.kind, record.trajectory) for record in self.records_superseded_by(key)}
        return {
            one.trajectory: one.reason
            for one in self.left_out
            if (one.by.name, one.by.trajectory) not in gone
        }

    @property
    def records(self) -> tuple[Record, ...]:
        """All results in order, valid and superseded."""
        standing = (stored.record for stored in self._standing.values())
        return tuple(sorted((*self._superseded, *standing), key=_number))

    def former(self, model: type[R]) -> tuple[Stored[R], ...]:
        """Return the superseded results of a model, in order. Raises REC-001, REC-003."""
        return results_of(model, sorted(self._superseded, key=_number))

    def ancestor(self, record: Record, model: type[R]) -> Stored[R]:
        """Return the nearest ancestor of a record that is of a model, valid or not. Raises PRO-001."""
        kinds, records = stand_ins(model), {one.identifier: one for one in self.records}
        for kind in kinds:
            if (found := ancestor_of_kind(record, kind, records)) is not None:
                return results_of(model, (found,))[0]
        raise StepRefused(f"{record.identifier} does not descend from any {model.kind}")

    @property
    def valid_results(self) -> tuple[Stored[StepResult], ...]:
        """Valid results, in order."""
        return tuple(self._standing.values())


def without_ancestors(standing: Iterable[Record]) -> frozenset[str]:
    """Return identifiers of valid results with an invalid ancestor.

    They belong to trajectories that were finished before something moved.
    """
    records = tuple(standing)
    stands = {record.identifier for record in records}
    past: set[str] = set()
    for record in records:
        if any(parent not in stands or parent in past for parent in record.parents):
            past.add(record.identifier)
    return frozenset(past)


def parent_of_kind(record: Record, model: type[StepResult], records: Mapping[str, Record]) -> Record | None:
    """Return a record's parent that is of a model, or stands in for it, from `records` (by identifier)."""
    kinds = stand_ins(model)
    return next((parent for parent in _parents(record, records) if parent.kind in kinds), None)


def ancestor_of_kind(record: Record, kind: str, records: Mapping[str, Record]) -> Record | None:
    """Return a record's nearest ancestor of a given kind from `records`, or None."""
    level = [record]
    while level:
        level = list({one.identifier: one for below in level for one in _parents(below, records)}.values())
        if found := next((one for one in level if one.kind == kind), None):
            return found
    return None


def _parents(record: Record, records: Mapping[str, Record]) -> Iterator[Record]:
    return (records[name] for name in record.parents if name in records)


def _number(record: Record) -> int:
    return int(record.identifier.partition("-")[0])
