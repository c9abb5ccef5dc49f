"""Finds run folders."""

from __future__ import annotations

from pathlib import Path

from procedures.cli.case.request_file import REQUEST_FILE
from procedures.engine.journal import JOURNAL_FILE
from ronna_hw.command_line.errors import PathProblem


def is_run(folder: Path) -> bool:
    """Whether a folder is that of a run."""
    return any((folder / name).exists() for name in (REQUEST_FILE, JOURNAL_FILE))


def require_run(folder: Path) -> None:
    """Raise CLI-005 for a folder that is not that of a run."""
    if not is_run(folder):
        raise PathProblem(f"{folder} is not the folder of a run", expected="a folder with journal.jsonl")


def runs_in(folder: Path) -> list[Path]:
    """The runs of a folder, oldest first. Raises CLI-005 when there is no such folder."""
    if not folder.is_dir():
        raise PathProblem(f"{folder} is not a folder", expected="a folder of runs")
    return sorted(path for path in folder.iterdir() if path.is_dir() and is_run(path))
