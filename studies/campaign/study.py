"""Studies, their units of work, and their result tables.

A unit has a seed of its own, so that every worker gets the same result.
"""

from __future__ import annotations

import csv
import io
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

Sums = dict[str, float]  # additive over units: counts and sums of squares
Cell = str | float | int | None


@dataclass(frozen=True)
class Unit:
    """Block `block` of the runs of a condition, whose key is readable, such as `patient 1, 4 fiducials`."""

    condition: str
    block: int
    runs: int

    @property
    def key(self) -> str:
        return f"{self.condition} #{self.block}"


class Study(Protocol):
    """A picklable study, whose `run` depends on nothing but its arguments."""

    @property
    def name(self) -> str:
        """Name of the command that runs the study."""
        ...

    def settings(self) -> dict[str, object]:
        """Return everything the results depend on, as plain data."""
        ...

    def units(self) -> Sequence[Unit]:
        """Return all units, in a fixed order that does not depend on the workers."""
        ...

    def run(self, unit: Unit) -> Sums:
        """Carry out one unit."""
        ...


def omit_empty_own(settings: dict[str, object]) -> dict[str, object]:
    """Return the settings without the entry for user methods if it is empty."""
    return {key: value for key, value in settings.items() if key != "own" or value}


def generator(seed: int, unit: Unit) -> np.random.Generator:
    """Return the random generator of a unit, seeded by the study's seed, the condition and the block only."""
    condition = zlib.crc32(unit.condition.encode())
    return np.random.default_rng(np.random.SeedSequence([seed, condition, unit.block]))


def blocks(condition: str, runs: int, block_runs: int) -> list[Unit]:
    """Split the runs of a condition into units of at most `block_runs`."""
    whole, rest = divmod(runs, block_runs)
    sizes = [block_runs] * whole + ([rest] if rest else [])
    return [Unit(condition, number, size) for number, size in enumerate(sizes)]


def add_up(finished: Iterable[tuple[Unit, Mapping[str, float]]]) -> dict[str, Sums]:
    """Add up the sums of each condition, in order of the conditions."""
    total: dict[str, Counter[str]] = {}
    for unit, sums in finished:
        total.setdefault(unit.condition, Counter()).update(sums)
    return {condition: dict(counter) for condition, counter in total.items()}


@dataclass(frozen=True)
class Table:
    """A table of plain values. `note` explains the figures and cites the source of published ones."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    @classmethod
    def of(cls, title: str, rows: Iterable[Mapping[str, Cell]], note: str = "") -> Self:
        """Build from rows that are mappings from the same columns to their cells."""
        listed = list(rows)
        return cls(title, list(listed[0]) if listed else (), [tuple(row.values()) for row in listed], note)

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [f"## {self.title}", ""]
        lines += [f"| {' | '.join(self.columns)} |", "|" + "---|" * len(self.columns)]
        lines += [f"| {' | '.join(format_cell(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", self.note, ""]) if self.note else "\n".join([*lines, ""])

    def csv(self) -> str:
        """Return the table as CSV for a spreadsheet, with all digits."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return text.getvalue()

    def document(self) -> dict[str, object]:
        """Return the table as plain data."""
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [list(row) for row in self.rows],
            "note": self.note,
        }


def yes_or_no(met: bool) -> str:
    """Format whether a goal was met, so that a missed goal stands out."""
    return "yes" if met else "NO"


def format_cell(value: Cell) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
