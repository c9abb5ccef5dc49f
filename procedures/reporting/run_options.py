"""Options with which a run was begun, as its request file states them.

The file is read as plain JSON: a run of another version is shown too, with whatever options it has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from procedures.journal.journal import Line
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_bytes
from ronna_hw.evidence.manifest import REQUEST_FILE

# Of the file, not of the run: its own version, and that of the program, which the journal has in full.
OF_THE_FILE = ("schema", "program")


@dataclass(frozen=True)
class RunOptions:
    """Options of a run by name; none for a run whose request is missing or unreadable."""

    values: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> str:
        """Scene of the simulated theatre, or its scene file; empty in a configured theatre."""
        return "" if self.values.get("config") else str(self.values.get("scene") or "")

    def is_scripted(self, *, simulated: bool) -> bool:
        """Whether a script gives the answers that no name signs; False where the options are not known."""
        if not self.values or not simulated or self.values.get("ask"):
            return False
        return not self.values.get("config") or bool(self.values.get("answers"))

    @property
    def faults(self) -> tuple[str, ...]:
        """Lines of the fault script with which the theatre was started."""
        lines = self.values.get("fault_lines")
        return tuple(map(str, lines)) if isinstance(lines, list) else ()


def read_options(folder: Path) -> RunOptions:
    """Read the options of a run."""
    try:
        content = parse_json(read_json_bytes(folder / REQUEST_FILE))
    except (OSError, ValueError, InputRefused):
        return RunOptions()
    if not isinstance(content, dict):
        return RunOptions()
    return RunOptions({name: value for name, value in content.items() if name not in OF_THE_FILE})


def find_seed(opened: Line) -> int | None:
    """Return the seed of the simulated theatre from the first line of a journal, or None."""
    seed = opened.get("seed")
    return seed if isinstance(seed, int) else None
