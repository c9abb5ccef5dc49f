"""The folder of a case that still runs, or was ended early."""

from __future__ import annotations

from pathlib import Path

from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, read_journal
from ronna_hw.evidence.manifest import ROOM_FILE
from ronna_hw.records import Record, read_record

REACHED_S = 100.0


def run_folder(out: Path) -> Path | None:
    """The only run in a folder of runs, if it is there yet."""
    return next(iter(out.iterdir()), None) if out.exists() else None


def await_motion_in(out: Path, step: str) -> None:
    """Return when the journal of the run holds a motion in that step."""
    eventually(lambda: moved_in(out, step), REACHED_S)


def moved_in(out: Path, step: str) -> bool:
    """Whether the journal of the run holds a motion in that step."""
    folder = run_folder(out)
    if folder is None or not (folder / JOURNAL_FILE).exists():
        return False
    if step.encode() not in (folder / JOURNAL_FILE).read_bytes():
        return False  # looked at two hundred times a second: it is checked and parsed at the end only
    lines = [(line["entry"], line.get("step")) for line in read_journal(folder / JOURNAL_FILE)]
    return ("intent", step) in lines and ("motion", None) in lines[lines.index(("intent", step)) :]


def records_of(folder: Path) -> list[Record]:
    """Every record of a run; none may be torn."""
    return [read_record(path) for path in sorted((folder / "records").glob("*.json"))]


def assert_nothing_half_written(out: Path) -> None:
    """A run that was ended left whole records and a whole journal, or nothing."""
    folder = run_folder(out)
    if folder is None:
        return
    assert [path.name for path in folder.rglob("*.partial") if path.name != ROOM_FILE] == []
    records_of(folder)
    if (folder / JOURNAL_FILE).exists():
        list(read_journal(folder / JOURNAL_FILE))
