"""Section on evidence: records with their parents, software and computer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Self

from procedures.journal.journal import Entry
from procedures.reporting.run_reading import RunReading
from ronna_hw.records import Record


@dataclass(frozen=True)
class Computer:
    """Versions of a run's packages, of its Python and of its system, as its log has them."""

    versions: Mapping[str, str] = field(default_factory=dict)
    python: str = ""
    system: str = ""

    @classmethod
    def of(cls, line: Mapping[str, Any]) -> Self:
        """Read the computer from the line with which a log opens."""
        versions = line.get("versions")
        named = versions if isinstance(versions, Mapping) else {}
        return cls(dict(named), str(line.get("python", "")), str(line.get("system", "")))


@dataclass(frozen=True)
class EvidenceSection:
    """Records of a run, its journal, and what made them."""

    records: tuple[Record, ...]
    superseded: Collection[str]  # identifiers
    lines: int  # of the journal
    motions: int
    software: tuple[str, ...]  # of each program that had the run
    computer: Computer
    made: str


def read_evidence(reading: RunReading) -> EvidenceSection:
    """Read the section."""
    journal = reading.run.journal
    software = (str(one) for line in journal if (one := line.get("software")))
    return EvidenceSection(
        records=reading.run.records,
        superseded=reading.run.superseded,
        lines=len(journal),
        motions=len(reading.run.lines(Entry.MOTION)),
        software=tuple(dict.fromkeys(software)),
        computer=Computer.of(next((line for line in reading.log if line.get("event") == "opened"), {})),
        made=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
    )
