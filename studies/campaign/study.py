"""Studies, their units of work, and tables of results.

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
    """Runs number `block` of a condition, which is a readable key such as `patient 1, 4 fiducials`."""

    condition: str
    block: int
    runs: int

    @property
    def key(self) -> str:
        return f"{self.condition} #{self.block}"


class Study(Protocol):
    """A picklable study whose `run` depends only on its arguments."""

    @property
    def name(self) -> str:
        """Name of the command that runs it."""
        ...

    def settings(self) -> dict[str, object]:
        """Return all inputs of the results as plain data."""
        ...

    def units(self) -> Sequence[Unit]:
        """Return all units, in a fixed order that does not depend on the workers."""
        ...

    def run(self, unit: Unit) -> Sums:
        """Carry out one unit."""
        ...


def omit_empty_own(settings: dict[str, object]) -> dict[str, object]:
    """User methods are a setting only of studies that have some."""
    return {key: value for key, value in settings.items() if key != "own" or value}


def generator(seed: int, unit: Unit) -> np.random.Generator:
    """Return the random numbers of a unit; they depend only on the study's seed, the condition and the block."""
    condition = zlib.crc32(unit.condition.encode())
    return np.random.default_rng(np.random.SeedSequence([seed, condition, unit.block]))


def blocks(condition: str, runs: int, block_runs: int) -> list[Unit]:
    """Split the runs of a condition into units of at most `block_runs`."""
    whole, rest = divmod(runs, block_runs)
    sizes = [block_runs] * whole + ([rest] if rest else [])
    return [Unit(condition, number, size) for number, size in enumerate(sizes)]


def add_up(finished: Iterable[tuple[Unit, Mapping[str, float]]]) -> dict[str, Sums]:
    """Return sums per condition, in their order."""
    total: dict[str, Counter[str]] = {}
    for unit, sums in finished:
        total.setdefault(unit.condition, Counter()).update(sums)
    return {condition: dict(counter) for condition, counter in total.items()}


@dataclass(frozen=True)
class Table:
    """Rows of plain values; `note` explains the figures and cites the source of published ones."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    @classmethod
    def of(cls, title: str, rows: Iterable[Mapping[str, Cell]], note: str = "") -> Self:
        """Build from rows that all map the same columns to their cells."""
        listed = list(rows)
        return cls(title, list(listed[0]) if listed else (), [tuple(row.values()) for row in listed], note)

    def markdown(self) -> str:
        """Return the table as Markdown."""
        lines = [f"## {self.title}", ""]
        lines += [f"| {' | '.join(self.columns)} |", "|" + "---|" * len(self.columns)]
        lines += [f"| {' | '.join(format_cell(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", self.note, ""]) if self.note else "\n".join([*lines, ""])

    def csv(self) -> str:
        """Return the table for a spreadsheet, with all digits."""
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
    """Word a goal so that a missed one is seen."""
    return "yes" if met else "NO"


def format_cell(value: Cell) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
