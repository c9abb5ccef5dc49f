"""The results of one run: immutable records in its folder, each with its parents.

RUN/journal.jsonl            what was intended and what came of it
RUN/records/05-....json      one result each
RUN/theatre/, RUN/case/      what the run worked with, when it brought it along
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from procedures.engine.errors import StepRefused
from ronna_hw.records import Record, write_record

RECORDS_FOLDER = "records"
PICTURES_FOLDER = "pictures"  # of spheres in the CT and in the stereo head, for people


class Case:
    """The run folder and the records made so far."""

    def __init__(self, folder: Path, series: Path, plan: Path) -> None:
        self.folder = folder
        self.series = series
        self.plan = plan
        self._records: dict[tuple[str, str | None], Record] = {}
        self._written = 0
        (folder / RECORDS_FOLDER).mkdir(parents=True, exist_ok=True)

    def add(
        self, kind: str, payload: dict[str, Any], parents: tuple[Record, ...], trajectory: str | None = None
    ) -> Record:
        """Store a result, by which its former one and everything made from that is superseded.

        Its id is its place in the run, its kind and its trajectory, and is never used twice.
        """
        self._written += 1
        name = "-".join(part for part in (f"{self._written:02d}", kind, trajectory) if part)
        record = Record(name, kind, tuple(parent.identifier for parent in parents), payload)
        write_record(record, self.folder / RECORDS_FOLDER)
        former = self._records.get((kind, trajectory))
        if former is not None:
            self._supersede(former.identifier)
        self._records[kind, trajectory] = record
        return record

    def _supersede(self, identifier: str) -> None:
        """Forget a record and whatever descends from it: no later step may read them."""
        gone = {identifier}
        for record in self.records:  # in order: a parent stands before its children
            if gone.intersection(record.parents):
                gone.add(record.identifier)
        self._records = {key: one for key, one in self._records.items() if one.identifier not in gone}

    def has(self, kind: str, trajectory: str | None = None) -> bool:
        """True when that result exists."""
        return (kind, trajectory) in self._records

    def get(self, kind: str, trajectory: str | None = None) -> Record:
        """A result; raises PRO-001 when it does not exist."""
        try:
            return self._records[kind, trajectory]
        except KeyError:
            where = f" for {trajectory}" if trajectory else ""
            raise StepRefused(f"there is no {kind}{where} yet") from None

    @property
    def records(self) -> tuple[Record, ...]:
        """All results, in order."""
        return tuple(self._records.values())
