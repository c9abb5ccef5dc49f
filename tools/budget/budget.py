"""Budget of processor time, theatre time and bytes, which every change meets.

    make budget                                        # the quick part
    make budget WHOLE=1                                # also the default case and the tests
    make budget STEADY=1                               # calls, theatre time, bytes: equal on any computer
    make budget WRITE="a second look at each sphere"   # the figures measured are the budget from now on

The figures stand in `budget.toml`, each with its date and the reason for it. Processor time counts in
calibrations (`calibration.py`), measured in the same run. A figure beyond its budget is measured twice more,
and the median counts. Beside other work a start-up still takes half as much again, so a check of every change
holds the steady figures alone; of processor time these are the calls of Python functions.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from statistics import median
from typing import Annotated

import tomlkit
import typer
from rich.console import Console
from rich.table import Table
from subjects import Measure, Measured, Subject, subjects

BUDGET = Path(__file__).with_name("budget.toml")
LARGEST, SMALLEST = 1.15, 0.9  # of the budget: beyond, the check fails; below, the budget is to be lowered
REPEATS = 2  # where a figure is outside of them


@dataclass(frozen=True)
class Entry:
    """A figure's budget since a date, and why it is that much."""

    date: date
    value: float
    unit: str
    because: str


@dataclass(frozen=True)
class Verdict:
    """A measured figure against its budget, None if it has none yet."""

    measured: Measured
    budget: float | None

    @property
    def ratio(self) -> float:
        """Measured value as a share of the budget."""
        return 1.0 if self.budget is None else self.measured.value / self.budget

    @property
    def exceeded(self) -> bool:
        """Whether the check fails."""
        return self.ratio > LARGEST

    @property
    def words(self) -> str:
        """Say what follows."""
        if self.budget is None:
            return "no budget yet"
        if self.exceeded:
            return "BEYOND"
        return "lower the budget" if self.ratio < SMALLEST else "within"


def read_budget(path: Path = BUDGET) -> dict[str, list[Entry]]:
    """Read the history of each figure, oldest first."""
    content = tomlkit.parse(path.read_text(encoding="utf-8")).unwrap() if path.exists() else {}
    return {name: [Entry(**entry) for entry in entries] for name, entries in content.items()}


def write_budget(verdicts: Sequence[Verdict], because: str, path: Path = BUDGET) -> None:
    """Append what was measured where it is not what the budget says, with today's date and a reason."""
    budget = read_budget(path)
    for one in verdicts:
        if one.budget is None or not SMALLEST <= one.ratio <= LARGEST:
            entry = Entry(date.today(), float(f"{one.measured.value:.3g}"), one.measured.unit, because)
            budget.setdefault(one.measured.name, []).append(entry)
    content = {name: [vars(entry) for entry in entries] for name, entries in budget.items()}
    path.write_text(tomlkit.dumps(content), encoding="utf-8")


def check(
    chosen: Sequence[Subject],
    budget: Mapping[str, Sequence[Entry]],
    status: Callable[[str], None],
    *,
    steady: bool = False,
) -> Iterator[Verdict]:
    """Measure subjects and hold their figures, or the steady ones among them, against the budget."""
    for subject in chosen:
        status(subject.name)
        for measure in (subject.steady, None if steady else subject.processor):
            if measure is not None:
                yield from _check_one(subject.name, measure, budget)


def _check_one(name: str, measure: Measure, budget: Mapping[str, Sequence[Entry]]) -> Iterator[Verdict]:
    rounds = [measure(name)]
    if any(one.budget is not None and one.words != "within" for one in _judge(rounds, budget)):
        rounds += [measure(name) for _ in range(REPEATS)]
    yield from _judge(rounds, budget)


def _judge(rounds: Sequence[Sequence[Measured]], budget: Mapping[str, Sequence[Entry]]) -> Iterator[Verdict]:
    for same in zip(*rounds, strict=True):
        first, entries = same[0], budget.get(same[0].name)
        measured = Measured(first.name, median(one.value for one in same), first.unit)
        yield Verdict(measured, entries[-1].value if entries else None)


def main(
    *,
    whole: Annotated[bool, typer.Option(help="Measure the default case and the tests too.")] = False,
    steady: Annotated[bool, typer.Option(help="Measure calls, theatre time and bytes alone.")] = False,
    only: Annotated[str, typer.Option(help="Subjects with this word in their name.")] = "",
    because: Annotated[str, typer.Option(help="Take what is measured as the budget, for this reason.")] = "",
) -> None:
    """Hold processor time, theatre time and bytes against their budget; exit code 1 beyond it."""
    budget, console = read_budget(), Console()
    chosen = [one for one in subjects() if (one.quick or whole or only) and only in one.name]
    table = Table("figure", "measured", "budget", "ratio", "")
    verdicts: list[Verdict] = []
    with Console(stderr=True).status("") as status:
        for one in check(chosen, budget, lambda name: status.update(f"measuring {name}"), steady=steady):
            verdicts.append(one)
            limit = "" if one.budget is None else f"{one.budget:.3g}"
            value = f"{one.measured.value:.3g} {one.measured.unit}"
            table.add_row(one.measured.name, value, limit, f"{one.ratio:.2f}", one.words)
    console.print(table)
    if because:
        write_budget(verdicts, because)
    elif any(one.exceeded for one in verdicts):
        console.print(
            f"Beyond {LARGEST:g} of the budget: find what takes it (make profile), or give a reason for the "
            'rise: make budget WRITE="reason".'
        )
        sys.exit(1)


if __name__ == "__main__":
    typer.run(main)
