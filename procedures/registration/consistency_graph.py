"""Which pairs of two point sets are compatible: the consistency graph and its cliques.

A node is one possible pair (image i, physical j). Two nodes are joined when the distance between the two
image points equals the distance between the two physical points, within what the noise allows. Pairs that are
all joined to each other, a clique, are the candidates for one rigid transform.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CLIQUE_SLACK = 2  # cliques up to two pairs smaller than the largest still compete
MOST_BRANCHES = 20_000  # tens of milliseconds; if it takes more, the noise is too large for the spacing


def consistency_graph(image_mm: Array, physical_mm: Array, tolerance_mm: float) -> NDArray[np.bool_]:
    """Adjacency (n*m, n*m); node i*m + j pairs image point i of n with physical point j of m."""
    within_image = np.linalg.norm(image_mm[:, None] - image_mm[None], axis=-1)
    within_physical = np.linalg.norm(physical_mm[:, None] - physical_mm[None], axis=-1)
    # A point has one partner: infinite distances of opposite sign exclude pairs that share i or j.
    np.fill_diagonal(within_image, np.inf)
    np.fill_diagonal(within_physical, -np.inf)
    difference = np.abs(within_image[:, None, :, None] - within_physical[None, :, None, :])
    nodes = len(image_mm) * len(physical_mm)
    return np.asarray(difference < tolerance_mm).reshape(nodes, nodes)


def prune(neighbours: list[int], smallest: int) -> list[int]:
    """Remove the nodes and edges that cannot be part of a clique of `smallest` nodes.

    In such a clique every node has all the others as neighbours, and both ends of an edge
    have them in common.
    """
    kept = list(neighbours)
    waiting = [node for node, row in enumerate(kept) if row]
    while waiting:
        _drop_lonely(kept, smallest - 1)
        touched = 0
        for node in waiting:
            row = kept[node]
            lost = 0
            for other in bits(row):
                if (row & kept[other]).bit_count() < smallest - 2:
                    lost |= 1 << other
            if lost:
                kept[node] = row ^ lost
                touched |= row
                for other in bits(lost):
                    kept[other] &= ~(1 << node)
        waiting = bits(touched)
    return kept


def _drop_lonely(kept: list[int], fewest: int) -> None:
    """Repeatedly remove, in place, nodes with too few neighbours."""
    lonely = [node for node, row in enumerate(kept) if row and row.bit_count() < fewest]
    while lonely:
        gone = 0
        for node in lonely:
            gone |= 1 << node
            kept[node] = 0
        for node, row in enumerate(kept):
            if row & gone:
                kept[node] = row & ~gone
        lonely = [node for node, row in enumerate(kept) if row and row.bit_count() < fewest]


@dataclass
class CliqueSearch:
    """Bron-Kerbosch search with pivoting over bit sets, for the maximal cliques near the largest size.

    `exhausted` is true when the search was cut off, so cliques may be missing.
    """

    adjacency: NDArray[np.bool_]
    fewest: int
    slack: int = CLIQUE_SLACK
    exhausted: bool = False
    largest: int = 0
    _neighbours: list[int] = field(default_factory=list)
    _found: list[int] = field(default_factory=list)
    _branches: int = 0

    def run(self) -> list[int]:
        """The maximal cliques as bit masks over the nodes, at least `fewest` and near the largest size."""
        self._neighbours = bit_rows(self.adjacency)
        self.largest = self._greedy()
        self._neighbours = prune(self._neighbours, self._bound())
        nodes = sum(1 << node for node, row in enumerate(self._neighbours) if row)
        if nodes:
            self._extend(0, 0, nodes, 0)
        bound = self._bound()
        return [clique for clique in self._found if clique.bit_count() >= bound]

    def _bound(self) -> int:
        return max(self.fewest, self.largest - self.slack)

    def _greedy(self) -> int:
        """Size of one large clique, grown from the best connected node; a first bound for the search."""
        best = max(self._neighbours, key=int.bit_count, default=0)
        if not best:
            return 0
        candidates, size = best, 1
        while candidates:
            node = max(bits(candidates), key=lambda one: (candidates & self._neighbours[one]).bit_count())
            candidates &= self._neighbours[node]
            size += 1
        return size

    def _extend(self, clique: int, size: int, candidates: int, excluded: int) -> None:
        self._branches += 1
        if self._branches > MOST_BRANCHES:
            self.exhausted = True
            return
        if not candidates:
            if not excluded and size >= self._bound():
                self._found.append(clique)
                self.largest = max(self.largest, size)
            return
        neighbours = self._neighbours
        pivot, covered = 0, -1
        for node in bits(candidates | excluded):
            count = (candidates & neighbours[node]).bit_count()
            if count > covered:
                pivot, covered = node, count
        for node in bits(candidates & ~neighbours[pivot]):
            bit = 1 << node
            inside = candidates & neighbours[node]
            if size + 1 + inside.bit_count() >= self._bound():
                self._extend(clique | bit, size + 1, inside, excluded & neighbours[node])
            candidates &= ~bit
            excluded |= bit


def bits(mask: int) -> list[int]:
    """The positions of the set bits, ascending."""
    positions = []
    while mask:
        lowest = mask & -mask
        positions.append(lowest.bit_length() - 1)
        mask ^= lowest
    return positions


def bit_rows(adjacency: NDArray[np.bool_]) -> list[int]:
    """Each row of an adjacency matrix as one integer, bit k for column k."""
    packed = np.packbits(adjacency, axis=1, bitorder="little")
    return [int.from_bytes(row.tobytes(), "little") for row in packed]
