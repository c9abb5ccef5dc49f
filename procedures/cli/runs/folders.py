"""Finds run folders."""

from __future__ import annotations

from pathlib import Path

from procedures.engine.events.event_file import EVENTS_FILE
from procedures.journal.journal import JOURNAL_FILE
from ronna_hw.command_line.errors import PathProblem
from ronna_hw.evidence.manifest import RECORDS_FOLDER, REQUEST_FILE
from ronna_hw.log_output import LOG_FILE
from ronna_hw.recording.flight_recorder import BYTES_FOLDER
from ronna_hw.text import counted, some_of

# One of them makes a folder a run.
RUN_PARTS = (REQUEST_FILE, JOURNAL_FILE, RECORDS_FOLDER, LOG_FILE, EVENTS_FILE, BYTES_FOLDER)


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a run, however little of it is left."""
    return any((folder / name).exists() for name in RUN_PARTS)


def require_run(folder: Path) -> None:
    """Raise CLI-005 for a folder that is not that of a run, with the runs that it holds."""
    if is_run(folder):
        return
    if folder.is_dir() and (held := [run.name for run in runs_in(folder)]):
        raise PathProblem(
            f"{folder} is not a run; it holds {counted(len(held), 'run')}: {some_of(held)}",
            action=f"Give one of them: {folder / held[-1]}.",
        )
    raise PathProblem(f"{folder} is not the folder of a run", expected="a folder with journal.jsonl")


def runs_in(folder: Path) -> list[Path]:
    """The runs of a folder, oldest first. Raises CLI-005 when there is no such folder."""
    if not folder.is_dir():
        raise PathProblem(f"{folder} is not a folder", expected="a folder of runs")
    return sorted(path for path in folder.iterdir() if path.is_dir() and is_run(path))
