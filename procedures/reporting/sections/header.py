"""Head of the report: what the run is of, and what must be known before anything is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from procedures.journal.journal import Line
from procedures.reporting.run_reading import RunReading
from procedures.reporting.tables import PlanRow, TargetTable


@dataclass(frozen=True)
class RunOpening:
    """First line of a run's journal; a field is empty where that says nothing."""

    procedure: str  # of a calibration, check or measurement
    theatre: str
    strategy: str
    seed: str
    banner: str
    methods: str
    processor: str

    @classmethod
    def of(cls, line: Line) -> Self:
        """Read the opening from a journal line."""
        return cls(
            procedure=str(line.get("procedure") or ""),
            theatre=str(line.get("theatre", "theatre unknown")),
            strategy=str(line.get("strategy") or ""),
            seed="" if (seed := line.get("seed")) is None else str(seed),
            banner=str(line.get("banner") or ""),
            methods=str(line.get("methods") or ""),
            processor=str(line.get("processor") or ""),
        )


@dataclass(frozen=True)
class Header:
    """Name and origin of a run, its banner, and later changes to its folder."""

    run: str
    origin: str
    banner: str
    errors: str  # where the errors of a simulated run come from
    methods: str
    changes: tuple[str, ...]


def read_header(
    run: str, reading: RunReading, opening: RunOpening, table: TargetTable, plan: Sequence[PlanRow]
) -> Header:
    """Read the head of the report."""
    errors = ""
    if table.errors_mm:
        errors = "Errors are measured against the simulated truth."
    elif table.rows:
        errors = "Errors are predicted: the true position of the needle tip was not available to this run."
    return Header(
        run=run,
        origin=_describe_origin(reading, opening, plan),
        banner=opening.banner,
        errors=errors,
        methods=f"{opening.methods[:1].upper()}{opening.methods[1:]}",
        changes=reading.changes,
    )


def _describe_origin(reading: RunReading, opening: RunOpening, plan: Sequence[PlanRow]) -> str:
    """Name procedure, theatre, strategy, seed and time of a run in one line."""
    strategy = f"strategy {opening.strategy}" if opening.strategy else ""
    used = list(dict.fromkeys(row.strategy for row in plan if row.strategy))
    if strategy and used and used != [opening.strategy]:
        strategy += f" asked for, {' and '.join(used)} used"
    seed = f"seed {opening.seed}" if opening.seed and "seed" not in opening.theatre else ""
    began, ended = (_host_time(reading, place) for place in (0, -1))
    time = f"{began} to {ended} UTC" if began else ""
    # The theatre has its place even where it is named by an empty text.
    named = [opening.procedure] if opening.procedure else []
    named += [opening.theatre, *(part for part in (strategy, seed, time) if part)]
    return " · ".join([*named, "research software, not a medical device"])


def _host_time(reading: RunReading, place: int) -> str:
    lines = reading.run.journal
    return str(lines[place].get("host_time", ""))[:19].replace("T", " ") if lines else ""
