"""Candidate pairings of two point sets: which pairs are compatible, and how likely sets of pairs are.

A node of the consistency graph is one possible pair (image i, physical j). Two nodes are joined when the
distance between the two image points equals that between the two physical points, within what the noise
allows. Pairs that are all joined to each other, a clique, are candidates for one rigid transform.

All candidates of one size are fitted as one stack. Scores are log odds (nats) against "all of these are
unrelated points": residuals cost q/2; every pair beyond the second earns the negative logarithm of the
probability of an accidental match within the noise. Two things are assumed a priori: most points are spheres
that both sides see, not strays; and the spheres are on one head.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from procedures.registration.correspondence import Hypothesis
from procedures.registration.rigid_fit import as_transform, fit_rigid, reflection_sum_mm2, residuals
from ronna_hw.arrays import Array, Mask

CLIQUE_SLACK = 2  # cliques up to two pairs smaller than the largest still compete
MOST_BRANCHES = 20_000  # tens of milliseconds; if it takes more, the noise is too large for the spacing

GATE_FALSE_ALARM = 1e-6  # probability that the gate rejects correct pairs
OUTLIER_BALL_RADIUS_MM = 300.0  # stray markers are within this ball around the head
LN_OUTLIER_VOLUME = math.log(4.0 / 3.0 * math.pi * OUTLIER_BALL_RADIUS_MM**3)
# Assumed, not measured: decision 10 shows how the answers depend on these odds.
PAIR_ODDS = 10.0  # a priori, that two points which could be the same sphere are
WIDE_SET_ODDS = 1e-3  # that pairs farther apart than a head is wide are all correct
WIDEST_HEAD_MM = 260.0  # between two spheres: a head 220 mm long, plus a base and half a sphere at each end
LINE_RATIO = 1e-3  # second over first singular value; below it a set is a line and fixes no rotation


def consistency_graph(image_mm: Array, physical_mm: Array, tolerance_mm: float) -> Mask:
    """Build the adjacency matrix (n*m, n*m); node i*m + j pairs image point i with physical point j."""
    within_image = np.linalg.norm(image_mm[:, None] - image_mm[None], axis=-1)
    within_physical = np.linalg.norm(physical_mm[:, None] - physical_mm[None], axis=-1)
    # A point has one partner: infinite distances of opposite sign exclude pairs that share i or j.
    np.fill_diagonal(within_image, np.inf)
    np.fill_diagonal(within_physical, -np.inf)
    difference = np.abs(within_image[:, None, :, None] - within_physical[None, :, None, :])
    nodes = len(image_mm) * len(physical_mm)
    return np.asarray(difference < tolerance_mm).reshape(nodes, nodes)


def prune(neighbours: list[int], smallest: int) -> list[int]:
    """Remove nodes and edges that cannot be part of a clique of `smallest` nodes.

    In such a clique every node has all the others as neighbours, and both ends of an edge
    have them in common.
    """
    kept = list(neighbours)
    waiting = [node for node, row in enumerate(kept) if row]
    while waiting:
        _drop_lonely(kept, smallest - 1)
        touched_mask = 0
        for node in waiting:
            row = kept[node]
            lost = 0
            for other in bits(row):
                if (row & kept[other]).bit_count() < smallest - 2:
                    lost |= 1 << other
            if lost:
                kept[node] = row ^ lost
                touched_mask |= row
                for other in bits(lost):
                    kept[other] &= ~(1 << node)
        waiting = bits(touched_mask)
    return kept


def _drop_lonely(kept: list[int], fewest: int) -> None:
    """Repeatedly remove nodes with too few neighbours, in place."""
    lonely = [node for node, row in enumerate(kept) if row and row.bit_count() < fewest]
    while lonely:
        removed = 0
        for node in lonely:
            removed |= 1 << node
            kept[node] = 0
        for node, row in enumerate(kept):
            if row & removed:
                kept[node] = row & ~removed
        lonely = [node for node, row in enumerate(kept) if row and row.bit_count() < fewest]


@dataclass
class CliqueSearch:
    """Bron-Kerbosch search with pivoting on bit sets for the maximal cliques near the largest size.

    `exhausted` is true when the search was cut off, so cliques may be missing.
    """

    adjacency: Mask
    fewest: int
    slack: int = CLIQUE_SLACK
    exhausted: bool = False
    largest: int = 0
    _neighbours: list[int] = field(default_factory=list)
    _found: list[int] = field(default_factory=list)
    _branches: int = 0

    def run(self) -> list[int]:
        """Find the maximal cliques near the largest size, as bit masks over the nodes."""
        self._neighbours = bit_rows(self.adjacency)
        self.largest = self._grow_greedily()
        self._neighbours = prune(self._neighbours, self._bound())
        nodes = sum(1 << node for node, row in enumerate(self._neighbours) if row)
        if nodes:
            self._extend(0, 0, nodes, 0)
        bound = self._bound()
        return [clique for clique in self._found if clique.bit_count() >= bound]

    def _bound(self) -> int:
        return max(self.fewest, self.largest - self.slack)

    def _grow_greedily(self) -> int:
        """Grow a clique greedily from the best connected node; return its size as an initial bound."""
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
    """List the positions of the set bits in ascending order."""
    positions = []
    while mask:
        lowest = mask & -mask
        positions.append(lowest.bit_length() - 1)
        mask ^= lowest
    return positions


def bit_rows(adjacency: Mask) -> list[int]:
    """Pack each row of an adjacency matrix into an integer, column k in bit k."""
    packed = np.packbits(adjacency, axis=1, bitorder="little")
    return [int.from_bytes(row.tobytes(), "little") for row in packed]


@dataclass(frozen=True)
class PairingEvidence:
    """Weight of evidence, from the combined variance per axis of both sets, mm2."""

    variance_mm2: float

    @property
    def nats_per_pair(self) -> float:
        """Score of each additional agreeing pair."""
        by_chance = LN_OUTLIER_VOLUME - 1.5 * math.log(2.0 * math.pi * self.variance_mm2)
        return math.log(PAIR_ODDS) + by_chance

    def most_nats(self, pairs: int) -> float:
        """Return an upper bound on the score of a candidate with this many pairs."""
        return (pairs - 2) * self.nats_per_pair


@lru_cache(maxsize=64)
def gate(pairs: int, false_alarm: float = GATE_FALSE_ALARM) -> float:
    """Return the chi-square limit for the residuals of a rigid fit to `pairs` pairs, under both noise models.

    If an error is normal on each axis, the residual is chi-square with 3k - 6 degrees of freedom. If its
    length is normal, in any direction, the variance is equal but the tail is longer: three times a chi-square
    with one degree per point, of which the fit takes 6 parts in 3k.
    """
    per_axis = float(chdtri(3 * pairs - 6, false_alarm))
    by_length = (3.0 - 6.0 / pairs) * float(chdtri(pairs, false_alarm))
    return max(per_axis, by_length)


@dataclass(frozen=True)
class PairingCandidate:
    """Fitted pairing. `nodes` is a bit mask, `chi_square` the residual sum over the variance."""

    nodes: int
    size: int
    chi_square: float
    mirrored_chi_square: float
    score_nats: float
    rotation: Array
    translation_mm: Array
    on_a_line: bool

    @property
    def passed(self) -> bool:
        """Whether noise explains the residuals and the points determine a rotation."""
        return self.chi_square < gate(self.size) and not self.on_a_line

    @property
    def mirror_excess(self) -> float:
        """Excess of chi-square over that of a mirror image; negative if the rotation fits better."""
        return self.chi_square - self.mirrored_chi_square

    @property
    def passed_mirrored(self) -> bool:
        """Whether a mirror image would pass but the rotation does not."""
        return not self.passed and not self.on_a_line and self.mirrored_chi_square < gate(self.size)


def evaluate(
    masks: Sequence[int], image_mm: Array, physical_mm: Array, evidence: PairingEvidence
) -> list[PairingCandidate]:
    """Fit and score pairings of equal size."""
    if not masks:
        return []
    nodes = np.array([bits(mask) for mask in masks])
    size = nodes.shape[1]
    image, physical = image_mm[nodes // len(physical_mm)], physical_mm[nodes % len(physical_mm)]
    fit = fit_rigid(image, physical)
    squares = np.square(residuals(fit, image, physical)).sum(axis=(1, 2))
    chi_squares = squares / evidence.variance_mm2
    mirrored = reflection_sum_mm2(fit, squares) / evidence.variance_mm2
    widths_mm = np.linalg.norm(image[:, :, None] - image[:, None], axis=-1).max(axis=(1, 2))
    prior_nats = np.where(widths_mm > WIDEST_HEAD_MM, math.log(WIDE_SET_ODDS), 0.0)
    scores = evidence.most_nats(size) + prior_nats - 0.5 * chi_squares
    on_a_line = fit.spread_mm2[:, 1] <= LINE_RATIO * fit.spread_mm2[:, 0]
    return [
        PairingCandidate(
            mask,
            size,
            float(chi_squares[row]),
            float(mirrored[row]),
            float(scores[row]),
            fit.rotation[row],
            fit.translation_mm[row],
            bool(on_a_line[row]),
        )
        for row, mask in enumerate(masks)
    ]


def as_hypothesis(one: PairingCandidate, physical_count: int) -> Hypothesis:
    """Convert a candidate to a hypothesis with index pairs, transform and score."""
    pairs = np.stack(np.divmod(np.array(bits(one.nodes), dtype=np.intp), physical_count), axis=1)
    transform = as_transform(one.rotation, one.translation_mm)
    return Hypothesis(pairs, transform, one.chi_square, gate(one.size), one.score_nats)
