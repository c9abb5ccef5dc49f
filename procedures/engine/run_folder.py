"""Run folders: their journal's lines, closing, and lineage charts."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from procedures.engine.case import StepKey
from procedures.engine.setting import ClinicalInput
from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, Journal, JournalValue, Line
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import Inspection
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain
from ronna_hw.evidence.manifest import (
    Manifest,
    hash_files_at_closing,
    hash_outside_files,
    keep_earlier_hashes,
)
from ronna_hw.logs import logger
from ronna_hw.wire.room_tasks import INSERT

_log = logger(part="engine")
SUPERSEDED = "superseded"


def step_key(line: Line) -> StepKey:
    """Return the step key of a journal line."""
    name, _, trajectory = str(line.get("step", "")).partition(":")
    return StepKey(name, trajectory or None)


def targets_in_doubt(journal: Iterable[Line]) -> dict[str, tuple[str, ...]]:
    """Return the findings about each target since its last insertion; its error may exceed the prediction."""
    doubts: dict[str, tuple[str, ...]] = {}
    for line in journal:
        if line["entry"] == Entry.STAGE and line.get("task") == INSERT and line.get("done") is False:
            doubts.pop(str(line["trajectory"]), None)
        elif line["entry"] == Entry.FINDING and isinstance(targets := line.get("targets"), list):
            for name in map(str, targets):
                doubts[name] = (*doubts.get(name, ()), str(line.get("text")))
    return doubts


class Recorder(Protocol):
    """Writes files of the run in parallel with the engine."""

    def close(self) -> None:
        """Write pending data and close the files. Bounded in time; never raises."""
        ...


def close_run(
    folder: Path,
    journal: Journal,
    theatre_time_s: float,
    outcome: str,
    clinical: ClinicalInput | None,
    **more: JournalValue,
) -> None:
    """Write the journal's last line and close it; `verify` reports any failure later."""
    try:
        evidence = _evidence(folder, clinical)
        journal.write(Entry.CLOSED, theatre_time_s, outcome=outcome, **more, **evidence)
    except JournalNotWritable:
        pass  # it has been reported where it broke; closing must go on
    finally:
        journal.close()


def _evidence(folder: Path, clinical: ClinicalInput | None) -> dict[str, JournalValue]:
    """Return hashes of the run's files, and of CT, scan, plan and proposed position outside its folder."""
    inputs = (
        () if clinical is None else (clinical.series, clinical.scan_series, clinical.plan, clinical.place)
    )
    try:
        expected = Manifest(read_chain(folder / JOURNAL_FILE).lines).unvouched_files
        hashes = keep_earlier_hashes(
            hash_files_at_closing(folder) | hash_outside_files(folder, inputs), expected
        )
    except (OSError, RonnaError) as error:  # closing must go on; verify says that the files are not named
        _log.error("files not hashed", error=str(error))
        return {}
    outside_inputs = {name: sha256 for name, sha256 in hashes.items() if Path(name).is_absolute()}
    files = {name: sha256 for name, sha256 in hashes.items() if name not in outside_inputs}
    found: dict[str, JournalValue] = {"files": files}
    return found | ({"inputs": outside_inputs} if outside_inputs else {})


def lineage_text(run: Inspection) -> str:
    """Return the lineage as text, with each result's parents indented below it.

    A result that was drawn before is only named again.
    """
    parents_of = {record.identifier: tuple(record.parents) for record in run.records}
    used = {name for parents in parents_of.values() for name in parents}
    drawn_names: set[str] = set()
    lines: list[str] = []
    waiting = [(name, 0) for name in parents_of if name not in used]
    while waiting:
        name, depth = waiting.pop()
        parents = parents_of.get(name)
        is_repeated = bool(parents) and name in drawn_names
        if parents is not None and not is_repeated:
            drawn_names.add(name)
            waiting += [(parent, depth + 1) for parent in reversed(parents)]
        mark = " (not in this run)" if parents is None else f" ({SUPERSEDED})" * (name in run.superseded)
        lines.append(f"{'  ' * depth}{name}{mark}{' ...' if is_repeated else ''}")
    return "\n".join(lines) + "\n"


def lineage_mermaid(run: Inspection) -> str:
    """Return the lineage as a Mermaid flowchart with arrows from parents to children."""
    number = {record.identifier: place for place, record in enumerate(run.records)}
    lines = ["flowchart TD"]
    for record in run.records:
        gone = record.identifier in run.superseded
        lines.append(f'  r{number[record.identifier]}["{record.identifier}"]' + (f":::{SUPERSEDED}" * gone))
    lines += [
        f"  r{number[name]} --> r{number[record.identifier]}"
        for record in run.records
        for name in record.parents
        if name in number
    ]
    lines.append(f"  classDef {SUPERSEDED} stroke-dasharray: 4 4, color: #888")
    return "\n".join(lines) + "\n"
