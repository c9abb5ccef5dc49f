"""Checks the step names in a fault script before a theatre is started: the theatre itself takes any name."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from ronna_hw.bounded_input import read_bounded
from ronna_hw.command_line.errors import UsageMistake

LARGEST_SCRIPT_BYTES = 1_000_000  # more than the theatre itself takes
_STEP_OF_LINE = re.compile(r"\s*(?:when|since)\s+step\s*==\s*(?P<step>\w+)")


def check_fault_script(path: Path, step_names: Collection[str]) -> None:
    """Raise CLI-001 for a missing file, and with every line that waits for a step that does not exist."""
    if not path.is_file():
        raise UsageMistake(f"there is no fault script {path}", action="Give the path of a file.")
    lines = enumerate(read_bounded(path, LARGEST_SCRIPT_BYTES).decode(errors="replace").splitlines(), 1)
    found = [(number, match["step"]) for number, line in lines if (match := _STEP_OF_LINE.match(line))]
    unknown = [
        f"line {number}: there is no step {step!r}" for number, step in found if step not in step_names
    ]
    if unknown:
        raise UsageMistake(
            f"{path.name}, {'; '.join(unknown)}",
            expected=f"one of {', '.join(step_names)}",
            action="Correct the fault script; ronna-procedure steps lists all steps.",
        )
