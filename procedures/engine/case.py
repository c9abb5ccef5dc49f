"""The results of one run: immutable records in its folder, each with its parents.

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
from procedures.journal.results import StepResult
from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.records import BadRecord, Record, file_sha256, is_stored, read_record, write_record

R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class StepKey:
    """One step of a case: a name, and its trajectory if it has one."""

    name: str
    trajectory: str | None = None

    def __str__(self) -> str:
        return f"{self.name}:{self.trajectory}" if self.trajectory else self.name


@dataclass(frozen=True)
class Exclusion:
    """A trajectory that a result leaves out of the case."""

    trajectory: str
    reason: str
    by: StepKey  # the step whose standing result says so; repeated, it may take the trajectory in again


@dataclass(frozen=True)
class Stored(Generic[R]):
    """A stored record and its parsed model."""

    record: Record
    result: R

    @cached_property
    def file_sha256(self) -> str:
        """Hash of the record's file."""
        return file_sha256(self.record)


class Case:
    """The run folder and its results: the valid ones, and those that a repeated step has superseded."""

    def __init__(self, folder: Path, run: str | None = None) -> None:
        """`run` is the run's original name, if its folder was renamed."""
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
        """Write a result, named by its place in the run, its kind and its trajectory. Raises REC-002.

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
        """Return the records that a new result of that step supersedes: its former result and descendants.

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
    def past(self) -> frozenset[str]:
        """Identifiers of results of finished trajectories that are valid without their ancestors."""
        return without_ancestors(stored.record for stored in self._standing.values())

    @property
    def past_trajectories(self) -> frozenset[str]:
        """Trajectories with such results: nothing is done for them any more."""
        past = self.past
        named = (one.record for one in self._standing.values() if one.record.identifier in past)
        return frozenset(record.trajectory for record in named if record.trajectory is not None)

    def accept(self, key: StepKey, stored: Stored[StepResult], finished: Collection[str] = ()) -> None:
        """Accept a result in place of those that it supersedes; see `records_superseded_by`."""
        self.void(key, finished)
        self._standing[key] = stored

    def void(self, key: StepKey, finished: Collection[str] = ()) -> None:
        """Void the result of that step and its descendants; see `records_superseded_by`."""
        gone = self.records_superseded_by(key, finished)
        self._superseded += gone
        self._standing = {kept: one for kept, one in self._standing.items() if one.record not in gone}

    def stands(self, key: StepKey) -> bool:
        """Whether that step has a result that has not been superseded."""
        return key in self._standing

    def record_of(self, key: StepKey) -> str | None:
        """Return the identifier of that step's valid result."""
        return self._standing[key].record.identifier if key in self._standing else None

    def was_superseded(self, key: StepKey) -> bool:
        """Whether that step had results, none of which is valid."""
        had_result = any(
            one.kind == key.name and one.trajectory == key.trajectory for one in self._superseded
        )
        return had_result and not self.stands(key)

    def find(self, model: type[R], trajectory: str | None) -> Stored[R] | None:
        """Return the valid result of that model, of a trajectory or of none."""
        for key in (StepKey(model.kind, trajectory), StepKey(model.kind)):
            if key in self._standing:
                return cast("Stored[R]", self._standing[key])
        return None

    def get(self, model: type[R], trajectory: str | None = None) -> Stored[R]:
        """Return what `find` finds. Raises PRO-001 without one, REC-001 if its file was changed."""
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
        """Whether that step has a valid result that is not in doubt."""
        return self.stands(key) and self.doubt_at(key) is None

    def doubt(self, key: StepKey, fault: str) -> None:
        """Put that step's valid result in doubt: the operator is asked whether it is kept."""
        if key in self._standing:
            self._doubts[self._standing[key].record.identifier] = fault

    def doubt_at(self, key: StepKey) -> str | None:
        """Return the fault that came after that step's own valid result."""
        return self._doubts.get(self.record_of(key) or "")

    def doubt_of(self, record: Record) -> str | None:
        """Return the fault that came after a record or one of its ancestors."""
        names = (record.identifier, *record.parents)
        return next((self._doubts[name] for name in names if name in self._doubts), None)

    def trust(self, record: Record) -> None:
        """Keep a record in spite of the fault."""
        for name in (record.identifier, *record.parents):
            self._doubts.pop(name, None)

    @property
    def left_out(self) -> tuple[Exclusion, ...]:
        """Trajectories that the valid results leave out."""
        return tuple(
            Exclusion(trajectory, reason, key)
            for key, stored in self._standing.items()
            for trajectory, reason in stored.result.leaves_out().items()
        )

    def exclusions_before(self, key: StepKey) -> dict[str, str]:
        """Return the trajectories that stay left out, and why, whatever a new result of that step says."""
        gone = {(record.kind, record.trajectory) for record in self.records_superseded_by(key)}
        return {
            one.trajectory: one.reason
            for one in self.left_out
            if (one.by.name, one.by.trajectory) not in gone
        }

    @property
    def records(self) -> tuple[Record, ...]:
        """Every result, in order, including those that are no longer valid."""
        standing = (stored.record for stored in self._standing.values())
        return tuple(sorted((*self._superseded, *standing), key=_number))

    @property
    def standing(self) -> tuple[Stored[StepResult], ...]:
        """The valid results, in order."""
        return tuple(self._standing.values())


def without_ancestors(standing: Iterable[Record]) -> frozenset[str]:
    """Return identifiers of valid results with an ancestor that is not valid any more, in order.

    They belong to trajectories that were finished before something moved.
    """
    records = tuple(standing)
    stands = {record.identifier for record in records}
    past: set[str] = set()
    for record in records:
        if any(parent not in stands or parent in past for parent in record.parents):
            past.add(record.identifier)
    return frozenset(past)


def parent_of_kind(record: Record, kind: str, records: Mapping[str, Record]) -> Record | None:
    """Return the parent of that kind of a record, among `records` by identifier; None without one."""
    return next((parent for parent in _parents(record, records) if parent.kind == kind), None)


def ancestor_of_kind(record: Record, kind: str, records: Mapping[str, Record]) -> Record | None:
    """Return the nearest ancestor of that kind of a record, among `records`; None without one."""
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
