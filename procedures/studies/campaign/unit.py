"""A unit of a study: some runs of one cell with its own seed, so that every worker gets the same result."""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

Sums = dict[str, float]  # additive over units: counts and sums of squares


@dataclass(frozen=True)
class Unit:
    """Runs number `block` of a cell. The cell is a readable key such as `patient 1, 4 fiducials`."""

    cell: str
    block: int
    runs: int

    @property
    def key(self) -> str:
        """Identity within a study."""
        return f"{self.cell} #{self.block}"


class Study(Protocol):
    """What the runner needs from a study: it can be pickled, and `run` depends only on its arguments."""

    @property
    def name(self) -> str:
        """Name of the command that runs it."""
        ...

    def parameters(self) -> dict[str, object]:
        """Everything that the results depend on, as plain data."""
        ...

    def units(self) -> Sequence[Unit]:
        """All units, in a fixed order that does not depend on the workers."""
        ...

    def run(self, unit: Unit) -> Sums:
        """Carry out one unit."""
        ...


def without_empty_own(parameters: dict[str, object]) -> dict[str, object]:
    """User methods are a parameter only of studies that have some."""
    return {key: value for key, value in parameters.items() if key != "own" or value}


def generator(seed: int, unit: Unit) -> np.random.Generator:
    """The random numbers of a unit; they depend only on the study's seed, the cell and the block."""
    cell = zlib.crc32(unit.cell.encode())
    return np.random.default_rng(np.random.SeedSequence([seed, cell, unit.block]))


def blocks(cell: str, runs: int, block_runs: int) -> list[Unit]:
    """Split the runs of a cell into units of at most `block_runs`."""
    whole, rest = divmod(runs, block_runs)
    sizes = [block_runs] * whole + ([rest] if rest else [])
    return [Unit(cell, number, size) for number, size in enumerate(sizes)]


def add_up(finished: Iterable[tuple[Unit, Mapping[str, float]]]) -> dict[str, Sums]:
    """Sums per cell, in the order of the cells."""
    total: dict[str, Counter[str]] = {}
    for unit, sums in finished:
        total.setdefault(unit.cell, Counter()).update(sums)
    return {cell: dict(counter) for cell, counter in total.items()}
