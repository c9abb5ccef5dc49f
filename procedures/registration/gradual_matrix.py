"""Similarity matrix that loses one point at a time: our improvement of the thesis' rule, a baseline as well.

Points whose best cell is lowest are removed one by one until all remaining points agree with each other, or
too few remain: the single worst point of the larger set goes first (of both sets, if equally large). The
number of markers need not be known, and a distance that disagrees costs one marker, where the rule as written
(`similarity_matrix`) loses the pairing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from procedures.registration.correspondence import MatchStatus
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.similarity_matrix import (
    Indices,
    SimilarityPairs,
    no_pairs,
    point_distances,
    similarity,
)
from ronna_hw.arrays import Array


def match_many_gradually(
    image_mm: Array, physical_mm: Array, tolerance_mm: Array
) -> tuple[SimilarityPairs, ...]:
    """Pair image points (b, n, 3) with physical points (b, m, 3), in mm, removing one point an iteration.

    Each reading has its own e (b,), mm; n and m are at least 3. UNIQUE when every remaining point has exactly
    one partner, AMBIGUOUS when some have several, else INCONSISTENT.
    """
    image, physical = point_distances(image_mm), point_distances(physical_mm)
    found: dict[int, SimilarityPairs] = {}
    for readings in _iterate_groups(len(image), image.shape[1], physical.shape[1]):
        rows = _sort_rows(image[readings.index], readings.rows)
        columns = _sort_rows(physical[readings.index], readings.columns)
        found |= readings.settle(similarity(rows, columns, tolerance_mm[readings.index]))
    return tuple(found[one] for one in range(len(image_mm)))


@dataclass
class _Readings:
    """Readings with equal numbers of remaining points: `index` (k,), `rows` (k, r), `columns` (k, c)."""

    index: Indices
    rows: Indices
    columns: Indices
    waiting: list[_Readings]  # destination of those that lose another point

    @property
    def size(self) -> tuple[int, int]:
        """Numbers of remaining image and physical points."""
        return self.rows.shape[1], self.columns.shape[1]

    def settle(self, matrix: Indices) -> dict[int, SimilarityPairs]:
        """Return the results of settled or exhausted readings; drop one point from each of the others."""
        r, c = self.size
        settled: dict[int, SimilarityPairs] = {}
        complete = matrix == r - 1 if r == c else np.zeros(matrix.shape, dtype=bool)
        is_settled = np.all(complete.any(axis=1), axis=1) & np.all(complete.any(axis=2), axis=1)
        per_column, per_row = np.asarray(complete.sum(axis=1)), np.asarray(complete.sum(axis=2))
        single = np.all(per_column == 1, axis=1) & np.all(per_row == 1, axis=1)
        for k in np.flatnonzero(is_settled):
            settled[int(self.index[k])] = no_pairs(MatchStatus.AMBIGUOUS)
            if single[k]:
                pairs = np.column_stack([self.rows[k], self.columns[k][complete[k].argmax(axis=1)]])
                settled[int(self.index[k])] = SimilarityPairs(MatchStatus.UNIQUE, pairs)
        rest = np.flatnonzero(~is_settled)
        if min(r, c) <= FEWEST_PAIRS and r == c:
            return settled | {int(self.index[k]): no_pairs(MatchStatus.INCONSISTENT) for k in rest}
        self._drop(matrix, rest)
        return settled

    def _drop(self, matrix: Indices, rest: Indices) -> None:
        row, row_best = _find_worst(matrix[rest])
        column, column_best = _find_worst(matrix[rest].swapaxes(1, 2))
        r, c = self.size
        of_rows = row_best <= column_best if r == c else np.full(len(rest), r > c)
        for drops_row, chosen in ((True, rest[of_rows]), (False, rest[~of_rows])):
            if not len(chosen):
                continue
            rows, columns = self.rows[chosen], self.columns[chosen]
            if drops_row:
                rows = _drop_position(rows, row[of_rows])
            else:
                columns = _drop_position(columns, column[~of_rows])
            self.waiting.append(_Readings(self.index[chosen], rows, columns, self.waiting))


def _iterate_groups(batch: int, n: int, m: int) -> Iterator[_Readings]:
    """Yield readings grouped by size, largest first, until none remain."""
    waiting: list[_Readings] = []
    everything = np.arange(batch)
    rows, columns = np.tile(np.arange(n), (batch, 1)), np.tile(np.arange(m), (batch, 1))
    waiting.append(_Readings(everything, rows, columns, waiting))
    while waiting:
        size = max(one.size for one in waiting)
        alike = [one for one in waiting if one.size == size]
        waiting[:] = [one for one in waiting if one.size != size]
        yield _Readings(
            np.concatenate([one.index for one in alike]),
            np.concatenate([one.rows for one in alike]),
            np.concatenate([one.columns for one in alike]),
            waiting,
        )


def _find_worst(matrix: Indices) -> tuple[Indices, Indices]:
    """Find the row whose best cell is lowest, breaking ties by row sum; return the row and that cell."""
    best = matrix.max(axis=2)
    most = matrix.shape[1] * matrix.shape[2] ** 2 + 1  # above any row sum
    worst = (best * most + matrix.sum(axis=2)).argmin(axis=1)
    return worst, np.take_along_axis(best, worst[:, None], axis=1)[:, 0]


def _drop_position(kept: Indices, position: Indices) -> Indices:
    """Drop the element at the given position from each row of `kept` (k, r)."""
    keep = np.arange(kept.shape[1]) != position[:, None]
    return np.asarray(kept[keep].reshape(len(kept), -1))


def _sort_rows(distances: Array, kept: Indices) -> Array:
    """Sort the distances from each kept point to the other kept points."""
    chosen = np.take_along_axis(distances, kept[:, :, None], axis=1)
    chosen = np.take_along_axis(chosen, kept[:, None, :], axis=2)
    return np.asarray(np.sort(chosen, axis=2)[:, :, 1:])  # the first is the distance to itself
