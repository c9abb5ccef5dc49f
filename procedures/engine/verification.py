"""Holds a run's folder against what journal and seal say of it: nothing changed, missing or added."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from procedures.engine.case import PICTURES_FOLDER, RECORDS_FOLDER
from procedures.engine.errors import JournalCorrupt, RunChanged
from procedures.engine.evidence import SEAL_FILE, files_of, read_seal, sha256_of
from procedures.engine.journal import JOURNAL_FILE, Entry, Line
from procedures.engine.journal_reading import read_chain
from procedures.engine.left_run import step_key
from ronna_hw.records import BadRecord, Record, read_record

REQUEST_FILE = "request.json"
SHOWN = 3  # problems that an error names; verify lists all


@dataclass(frozen=True)
class Problem:
    """One file that is not as the run left it, and how."""

    file: str
    what: str

    def __str__(self) -> str:
        return f"{self.file}: {self.what}"


def problems_of(folder: Path) -> tuple[Problem, ...]:
    """Everything in which a run's folder is not as the run left it; empty for a whole one."""
    return tuple(dict.fromkeys(_problems(folder)))


def require_whole(folder: Path) -> None:
    """Raise PRO-033 unless the folder of a run is as the run left it."""
    if problems := problems_of(folder):
        more = f" and {len(problems) - SHOWN} more" if len(problems) > SHOWN else ""
        raise RunChanged(f"{folder.name} is not whole: {'; '.join(map(str, problems[:SHOWN]))}{more}")


def changed_since_closing(folder: Path, lines: tuple[Line, ...]) -> tuple[Problem, ...]:
    """What of the files that the last `closed` line names is changed or missing; not what came since."""
    return tuple(_against(folder, closed_files(lines)))


def closed_files(lines: tuple[Line, ...]) -> dict[str, str]:
    """Files and hashes of the journal's last `closed` line."""
    closed = next((line for line in reversed(lines) if line["entry"] == Entry.CLOSED), {})
    return _hashes(closed, "files")


def _problems(folder: Path) -> Iterator[Problem]:
    path = folder / JOURNAL_FILE
    if not path.exists():
        yield Problem(JOURNAL_FILE, "missing: the run never began, or is none")
        return
    try:
        chain = read_chain(path)
    except JournalCorrupt as problem:
        yield Problem(JOURNAL_FILE, problem.what)
        return
    lines = chain.lines
    if chain.torn:
        yield Problem(JOURNAL_FILE, f"torn: {len(chain.torn)} bytes after line {len(lines)}")
    closed = bool(lines) and lines[-1]["entry"] == Entry.CLOSED
    if not closed:
        yield Problem(JOURNAL_FILE, "not closed: the run was killed, still runs, or its last lines are gone")
    yield from _request(folder, lines)
    yield from _results(folder, lines)
    named = closed_files(lines)
    yield from _against(folder, named)
    yield from _against(Path("/"), _hashes(lines[-1], "inputs") if lines else {})
    seal = read_seal(folder)
    if seal is None:
        if closed:
            there = (folder / SEAL_FILE).exists()
            yield Problem(SEAL_FILE, "changed" if there else "missing: the run's end was not sealed")
        return
    if seal.journal_sha256 != sha256_of(path):
        yield Problem(JOURNAL_FILE, "not the journal that was sealed: lines were added or removed at its end")
    yield from _against(folder, seal.files)
    for name, _ in files_of(folder):
        if name not in named and name not in seal.files:
            yield Problem(name, "added: no part of the run")


def _against(folder: Path, hashes: Mapping[str, str]) -> Iterator[Problem]:
    for name, recorded in hashes.items():
        path = folder / name
        try:
            if sha256_of(path) != recorded:
                yield Problem(name, "changed")
        except FileNotFoundError:
            yield Problem(name, "missing")
        except OSError as error:
            yield Problem(name, f"cannot be read: {error.strerror}")


def _request(folder: Path, lines: tuple[Line, ...]) -> Iterator[Problem]:
    recorded = lines[0].get("request_sha256") if lines else None
    if isinstance(recorded, str):
        yield from _against(folder, {REQUEST_FILE: recorded})


def _results(folder: Path, lines: tuple[Line, ...]) -> Iterator[Problem]:
    """Every record against its line and its parents, every picture against its line."""
    known: dict[str, str] = {}
    pictures: dict[str, str] = {}
    for line in lines:
        if line["entry"] != Entry.RESULT:
            continue
        name = f"{RECORDS_FOLDER}/{line['record']}.json"
        try:
            record = read_record(folder / name)
        except BadRecord as problem:
            yield Problem(name, problem.what if (folder / name).exists() else "missing")
        else:
            yield from (Problem(name, what) for what in _record(record, line, known))
        known[str(line["record"])] = str(line["sha256"])
        # A repeated step draws its pictures again, under the same names.
        pictures.update(_hashes(line, "pictures"))
    yield from _against(folder, {f"{PICTURES_FOLDER}/{name}": of for name, of in pictures.items()})


def _record(record: Record, line: Line, known: Mapping[str, str]) -> Iterator[str]:
    key = step_key(line)
    if record.sha256 != line["sha256"]:
        yield "not the record that the journal names"
    if record.identifier != line["record"]:
        yield f"says that it is {record.identifier}"
    if (record.kind, record.trajectory) != (key.name, key.trajectory):
        yield f"is of {record.kind} {record.trajectory or ''}, not of {key}"
    for identifier, of in record.parents.items():
        if known.get(identifier) != of:
            yield f"its parent {identifier} is not an earlier record of this run"


def _hashes(line: Line, field: str) -> dict[str, str]:
    found = line.get(field)
    return cast("dict[str, str]", dict(found)) if isinstance(found, Mapping) else {}
