"""Files that a command writes at its end, checked before its work begins."""

from __future__ import annotations

from pathlib import Path

from ronna_hw.command_line.errors import PathProblem, UsageMistake


def require_folder_of(*files: Path) -> None:
    """Raise CLI-005 for a file whose folder does not exist."""
    for file in files:
        if not file.parent.is_dir():
            raise PathProblem(
                f"{file.parent} is not a folder",
                expected=f"an existing folder for {file.name}",
                action="Create the folder, or name another.",
            )


def require_folder(out: Path) -> None:
    """Raise CLI-005 where `--out` names a file in place of a folder."""
    if out.exists() and not out.is_dir():
        raise PathProblem(f"--out: {out} is a file", expected="a folder, which may be new")


def require_new(*files: Path) -> None:
    """Raise CLI-001 for a file that exists, CLI-005 for one whose folder does not."""
    for file in files:
        if file.exists():
            raise UsageMistake(f"{file} exists and was not changed", action="Name a new file with --out.")
    require_folder_of(*files)
