"""Assigns the instruments and holes that were found to trajectories, at most one each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from procedures.postoperative.way import SEARCH_MM, Way

Array = NDArray[np.float64]

ONE_INSTRUMENT_MM = 1.5  # axes closer than this are one instrument; electrodes are wider
INSTEAD_MM = 10.0 * SEARCH_MM  # a hole counts only if no instrument is left, a failed fit only after both
NOTHING_MM = 1e6  # and none only if nothing is left


class FoundKind(StrEnum):
    """What was found along a trajectory."""

    INSTRUMENT = "instrument"  # an electrode or a needle: a rod of metal
    DRILL_HOLE = "drill hole"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A rod or hole in coordinates of the planned CT: its tip, or a point in the bone, (3,) mm, and its axis.

    `failures` says why it cannot be used at all, `doubts` why it may be wrong.
    """

    kind: FoundKind
    point_mm: Array
    inwards: Array
    failures: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def passes_mm(self, point_mm: Array) -> float:
        """Distance of its axis from a point (3,)."""
        return float(np.linalg.norm(np.cross(point_mm - self.point_mm, self.inwards)))

    def is_also(self, other: Candidate) -> bool:
        """Whether both are the same instrument, the same hole, or an instrument in its hole."""
        if self.kind is other.kind is FoundKind.DRILL_HOLE:
            return float(np.linalg.norm(self.point_mm - other.point_mm)) < ONE_INSTRUMENT_MM
        near = (  # a hole's direction is too uncertain to extrapolate to a tip
            one.passes_mm(another.point_mm) < ONE_INSTRUMENT_MM
            for one, another in ((self, other), (other, self))
            if one.kind is FoundKind.INSTRUMENT
        )
        return all(near)


def assigned(
    ways: Mapping[str, Way], candidates: Mapping[str, Sequence[Candidate]]
) -> tuple[dict[str, Candidate], dict[str, str]]:
    """The candidate of each trajectory, by least total distance, and who took what others might have had.

    `ways` are the planned ones, `candidates` what was found along each; both by name.
    """
    names = list(ways)
    things: list[Candidate] = []
    nearest: dict[tuple[int, int], tuple[float, Candidate]] = {}  # by trajectory and candidate
    for row, name in enumerate(names):
        for one in candidates[name]:
            number = next((k for k, thing in enumerate(things) if thing.is_also(one)), len(things))
            if number == len(things):
                things.append(one)
            cost_mm = _beside_mm(ways[name], one)
            if cost_mm < nearest.get((row, number), (NOTHING_MM, one))[0]:
                nearest[row, number] = cost_mm, one
    costs_mm = np.full((len(names), len(things) + len(names)), NOTHING_MM)
    for place, (cost_mm, _) in nearest.items():
        costs_mm[place] = cost_mm
    pairs = zip(*(indices.tolist() for indices in linear_sum_assignment(costs_mm)), strict=True)
    taken = {number: row for row, number in pairs if (row, number) in nearest}
    found = {names[row]: nearest[row, number][1] for number, row in taken.items()}
    lost_to = {names[row]: names[taken[number]] for row, number in nearest if names[row] not in found}
    return found, lost_to


def _beside_mm(way: Way, one: Candidate) -> float:
    """Mean distance by which a candidate's axis misses entry and target."""
    beside_mm = 0.5 * (one.passes_mm(way.entry_mm) + one.passes_mm(way.target_mm))
    last_of_all = (one.kind is FoundKind.DRILL_HOLE) + 2 * bool(one.failures)
    return beside_mm + last_of_all * INSTEAD_MM
