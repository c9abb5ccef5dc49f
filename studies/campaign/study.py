"""Studies, their units of work, and their result tables.

A unit has a seed of its own, so that every worker gets the same result.
"""

from __future__ import annotations

import csv
import io
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import ClassVar, Self

import numpy as np

Sums = dict[str, float]  # additive over units: counts and sums of squares
Cell = str | float | int | None


@dataclass(frozen=True)
class Unit:
    """Block number `block` of the runs under one condition."""

    condition: str
    block: int
    runs: int

    @property
    def key(self) -> str:
        return f"{self.condition} #{self.block}"


@dataclass(frozen=True)
class Study(ABC):
    """A picklable study, whose `run` depends only on its fields and its argument."""

    constants: ClassVar[Mapping[str, object]] = {}  # of the code, that are shown with the results

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the command that runs the study."""

    def settings(self) -> dict[str, object]:
        """Return everything that affects the results, as plain data; user methods only if there are any."""
        fields = {name: value for name, value in asdict(self).items() if name != "own" or value}
        return {**fields, **self.constants}

    @abstractmethod
    def units(self) -> Sequence[Unit]:
        """Return all units in a fixed order, independent of the workers."""

    @abstractmethod
    def run(self, unit: Unit) -> Sums:
        """Run one unit and return its sums."""


def generator(seed: int, unit: Unit) -> np.random.Generator:
    """Return a unit's random generator, seeded only by study seed, condition and block."""
    condition = zlib.crc32(unit.condition.encode())
    return np.random.default_rng(np.random.SeedSequence([seed, condition, unit.block]))


def blocks(condition: str, runs: int, block_runs: int) -> list[Unit]:
    """Split the runs of a condition into units of at most `block_runs`."""
    whole, rest = divmod(runs, block_runs)
    sizes = [block_runs] * whole + ([rest] if rest else [])
    return [Unit(condition, number, size) for number, size in enumerate(sizes)]


def blocks_of_each(keys: Iterable[Iterable[object]], runs: int, block_runs: int) -> list[Unit]:
    """Split the runs of every condition, whose key is joined with bars."""
    return [unit for key in keys for unit in blocks("|".join(map(str, key)), runs, block_runs)]


def as_sums(counts: Mapping[str, float]) -> Sums:
    return {key: float(value) for key, value in counts.items()}


def pool(every: Iterable[Mapping[str, float]]) -> Sums:
    total: Counter[str] = Counter()
    for sums in every:
        total.update(sums)
    return dict(total)


def add_up(finished: Iterable[tuple[Unit, Mapping[str, float]]]) -> dict[str, Sums]:
    """Total the sums of each condition, preserving the order of conditions."""
    total: dict[str, Counter[str]] = {}
    for unit, sums in finished:
        total.setdefault(unit.condition, Counter()).update(sums)
    return {condition: dict(counter) for condition, counter in total.items()}


@dataclass(frozen=True)
class Table:
    """A table of plain values.

    `note` explains the figures and cites the source of published ones; `lead` stands above the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""
    lead: str = ""

    @classmethod
    def of(cls, title: str, rows: Iterable[Mapping[str, Cell]], note: str = "") -> Self:
        """Build a table from rows that map the same columns to cells."""
        listed = list(rows)
        return cls(title, list(listed[0]) if listed else (), [tuple(row.values()) for row in listed], note)

    def markdown(self) -> str:
        lines = [f"## {self.title}", "", *((self.lead, "") if self.lead else ())]
        lines += [f"| {' | '.join(self.columns)} |", "|" + "---|" * len(self.columns)]
        lines += [f"| {' | '.join(format_cell(value) for value in row)} |" for row in self.rows]
        return "\n".join([*lines, "", self.note, ""]) if self.note else "\n".join([*lines, ""])

    def csv(self) -> str:
        """Return the table as CSV for a spreadsheet, at full precision."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(self.rows)
        return text.getvalue()

    def document(self) -> dict[str, object]:
        return {
            "title": self.title,
            "columns": list(self.columns),
            "rows": [list(row) for row in self.rows],
            "note": self.note,
        }


GOALS = ("figure", "value", "goal", "met")  # columns of a table of goals


def judge(figure: str, value: Cell, goal: str, met: bool) -> Sequence[Cell]:
    """Return the row of a figure in a table of goals."""
    return figure, value, goal, yes_or_no(met)


def judge_at_most(figure: str, value: float, most: float) -> Sequence[Cell]:
    return judge(figure, value, f"at most {most:g}", value <= most)


def judge_at_least(figure: str, value: float, least: float) -> Sequence[Cell]:
    return judge(figure, value, f"at least {least:g}", value >= least)


def judge_within(figure: str, value: float, range_: tuple[float, float]) -> Sequence[Cell]:
    low, high = range_
    return judge(figure, value, f"{low:g} to {high:g}", low <= value <= high)


def yes_or_no(met: bool) -> str:
    """Format whether a goal was met, so that missed goals stand out."""
    return "yes" if met else "NO"


def format_cell(value: Cell) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
