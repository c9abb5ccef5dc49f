"""A run read for its report: as far as it can be read, with a note of everything that cannot.

A report is wanted most of the run that went wrong; a journal that breaks off or a record that was changed is
said in it and keeps nothing else from being shown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from procedures.engine.case import RECORDS_FOLDER, Stored
from procedures.engine.errors import JournalCorrupt
from procedures.engine.journal import JOURNAL_FILE, Entry, Line, read_journal
from procedures.engine.result import StepResult
from procedures.engine.run_folder import RunFolder, typed
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_lines
from ronna_hw.errors import RonnaError
from ronna_hw.log_output import LOG_FILE
from ronna_hw.records import BadRecord, Record, read_record

R = TypeVar("R", bound=StepResult)


@dataclass(frozen=True)
class RunReading:
    """What a run folder holds, and in `problems` what of it cannot be relied on."""

    run: RunFolder
    log: tuple[Mapping[str, Any], ...]  # lines of log.jsonl
    problems: list[str] = field(default_factory=list)

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return self.run.path

    def standing(self, model: type[R]) -> tuple[Stored[R], ...]:
        """The results of a step that stand and can be read, in order."""
        found = []
        for record in self.run.records:
            if record.kind == model.kind and record.identifier not in self.run.superseded:
                try:
                    found.append(Stored(record, typed(record, model)))
                except RonnaError as error:
                    self.note(str(error))
        return tuple(found)

    def find(self, model: type[R]) -> R | None:
        """The result of a step that is done once, if it stands and can be read."""
        found = self.standing(model)
        return found[-1].result if found else None

    def note(self, problem: str) -> None:
        """Note once what cannot be relied on."""
        if problem not in self.problems:
            self.problems.append(problem)


def read_for_report(folder: Path) -> RunReading:
    """Read a run folder; raises nothing that its content can cause."""
    problems: list[str] = []
    journal = _journal(folder, problems)
    results = [line for line in journal if line["entry"] == Entry.RESULT]
    records = [record for line in results if (record := _record(folder, line, problems)) is not None]
    gone = [line["supersedes"] for line in journal if isinstance(line.get("supersedes"), list)]
    superseded = frozenset(str(name) for names in gone if isinstance(names, list) for name in names)
    return RunReading(RunFolder(folder, tuple(journal), tuple(records), superseded), _log(folder), problems)


def _journal(folder: Path, problems: list[str]) -> list[Line]:
    lines: list[Line] = []
    path = folder / JOURNAL_FILE
    try:
        lines.extend(read_journal(path))  # what comes before a broken line is kept
    except FileNotFoundError:
        problems.append("There is no journal: the run ended before its theatre was open.")
    except JournalCorrupt as error:
        problems.append(f"{error}. What follows that line is not shown.")
    except OSError as error:
        problems.append(f"{path.name} cannot be read: {error.strerror}")
    else:
        if path.stat().st_size and not path.read_bytes().endswith(b"\n"):
            problems.append("The last line of the journal is torn: the program ended while it wrote it.")
    return lines


def _record(folder: Path, line: Line, problems: list[str]) -> Record | None:
    name = str(line.get("record"))
    try:
        record = read_record(folder / RECORDS_FOLDER / f"{name}.json")
    except (BadRecord, OSError) as error:
        problems.append(f"{name}: {error}")
        return None
    if record.sha256 != line.get("sha256"):
        problems.append(f"{name}.json is not the record that the journal names; it is left out.")
        return None
    return record


def _log(folder: Path) -> tuple[Mapping[str, Any], ...]:
    lines = []
    try:
        text = read_json_lines(folder / LOG_FILE)
    except (OSError, InputRefused):
        return ()
    for line in text.splitlines():
        try:
            content = parse_json(line)
        except ValueError:
            continue
        if isinstance(content, dict):
            lines.append(content)
    return tuple(lines)
