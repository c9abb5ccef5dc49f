"""Similarity matrix correspondence as the thesis has it (5.3): a baseline, not for clinical use.

Cell (i, j) counts the distances from image point i that equal one from physical point j within e. The number
N of markers is known: a cell passes with at least N - 1 equal distances. Every row and column without a
passing cell is removed at once, and the matrix is computed again from the points that remain, until nothing
more is removed. The pairing is found if N points of each set remain, each with one partner.

The thesis does not state the condition of a cell, nor how a cell counts. Here distances are matched one to
one in order of length. The text can also be read such that a distance counts whenever *any* of the other
point's matches it (`Counting.ANY`): two similar distances then make two points similar, which limits e from
above.

Many readings with equally many points are solved at once, because a study repeats this millions of times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from procedures.registration.correspondence import MatchStatus
from ronna_hw.arrays import Array, Mask

Indices = NDArray[np.intp]
# Distances of removed points, and ends of rows, in image and physical set: no two of them ever match.
NO_IMAGE_DISTANCE, NO_PHYSICAL_DISTANCE = np.inf, 1e300


class Counting(StrEnum):
    """How a cell counts: every distance at most once, or each that has any counterpart."""

    ONE_TO_ONE = "one to one"
    ANY = "with any counterpart"


@dataclass(frozen=True)
class SimilarityPairs:
    """Result for one reading: pairs (k, 2) if UNIQUE, otherwise none."""

    status: MatchStatus
    pairs: Indices


@dataclass(frozen=True)
class SimilarityStep:
    """One iteration: the remaining image and physical points, and the matrix between them."""

    rows: Indices
    columns: Indices
    matrix: Indices


def match_many_by_similarity(
    image_mm: Array,
    physical_mm: Array,
    tolerance_mm: Array,
    markers: int,
    counting: Counting = Counting.ONE_TO_ONE,
) -> tuple[SimilarityPairs, ...]:
    """Pair image points (b, n, 3) with physical points (b, m, 3), in mm, by the rule of the thesis.

    Each reading has its own e (b,), mm, and all have `markers` true pairs; this, n and m are at least 3.
    INCONSISTENT if fewer points remain, AMBIGUOUS if more do, or some with several partners.
    """
    passing = np.zeros((len(image_mm), image_mm.shape[1], physical_mm.shape[1]), dtype=bool)
    for readings, matrix in _iterate_matrices(image_mm, physical_mm, tolerance_mm, markers, counting):
        passing[readings] = matrix >= markers - 1
    return _settle(passing, markers)


def similarity_steps(
    image_mm: Array, physical_mm: Array, tolerance_mm: float, markers: int
) -> tuple[tuple[SimilarityStep, ...], SimilarityPairs]:
    """Return every iteration of one reading, points (n, 3) and (m, 3) in mm, and its result."""
    rows, columns = np.arange(len(image_mm)), np.arange(len(physical_mm))
    passing = np.zeros((len(rows), len(columns)), dtype=bool)
    steps: list[SimilarityStep] = []
    for _, (matrix,) in _iterate_matrices(
        image_mm[None], physical_mm[None], np.array([tolerance_mm]), markers, Counting.ONE_TO_ONE
    ):
        steps.append(SimilarityStep(rows, columns, matrix[np.ix_(rows, columns)]))
        passing = matrix >= markers - 1
        rows, columns = np.flatnonzero(passing.any(axis=1)), np.flatnonzero(passing.any(axis=0))
    return tuple(steps), _settle(passing[None], markers)[0]


def _iterate_matrices(
    image_mm: Array, physical_mm: Array, tolerance_mm: Array, markers: int, counting: Counting
) -> Iterator[tuple[Indices, Indices]]:
    """Yield the readings (k,) that lose points, all at first, and their matrices (k, n, m), until none does.

    The cells of removed points are 0.
    """
    image, physical = point_distances(image_mm), point_distances(physical_mm)
    count = similarity if counting is Counting.ONE_TO_ONE else similarity_to_any
    rows, columns = np.ones(image.shape[:2], dtype=bool), np.ones(physical.shape[:2], dtype=bool)
    readings = np.arange(len(image))
    while len(readings):
        matrix = count(
            _sort_kept(image[readings], rows[readings], NO_IMAGE_DISTANCE),
            _sort_kept(physical[readings], columns[readings], NO_PHYSICAL_DISTANCE),
            tolerance_mm[readings],
        )
        yield readings, matrix
        passing = matrix >= markers - 1
        kept_rows, kept_columns = passing.any(axis=2), passing.any(axis=1)
        has_lost = np.any(kept_rows != rows[readings], axis=1) | np.any(
            kept_columns != columns[readings], axis=1
        )
        may_succeed = np.minimum(kept_rows.sum(axis=1), kept_columns.sum(axis=1)) >= markers
        rows[readings], columns[readings] = kept_rows, kept_columns
        readings = readings[has_lost & may_succeed]


def _settle(passing: Mask, markers: int) -> tuple[SimilarityPairs, ...]:
    """Return the results of readings with these passing cells (b, n, m) in their last matrices."""
    rows, columns = passing.any(axis=2).sum(axis=1), passing.any(axis=1).sum(axis=1)
    has_too_few = np.minimum(rows, columns) < markers
    is_unique = (rows == markers) & (columns == markers) & (passing.sum(axis=(1, 2)) == markers)
    pairs = iter(np.argwhere(passing[is_unique])[:, 1:].reshape(-1, markers, 2))
    return tuple(
        SimilarityPairs(MatchStatus.UNIQUE, next(pairs))
        if unique
        else no_pairs(MatchStatus.INCONSISTENT if too_few else MatchStatus.AMBIGUOUS)
        for unique, too_few in zip(is_unique.tolist(), has_too_few.tolist(), strict=True)
    )


def no_pairs(status: MatchStatus) -> SimilarityPairs:
    """Return the result of a reading without a pairing."""
    return SimilarityPairs(status, np.empty((0, 2), dtype=np.intp))


def point_distances(points: Array) -> Array:
    """Return the distances (b, n, n) between the points (b, n, 3) of each reading."""
    return np.asarray(np.linalg.norm(points[:, :, None] - points[:, None], axis=-1))


def _sort_kept(distances: Array, kept: Mask, elsewhere: float) -> Array:
    """Sort the distances (b, n, n) from each kept point to the other kept points (b, n), others last."""
    within = np.where(kept[:, :, None] & kept[:, None, :], distances, elsewhere)
    return np.asarray(np.sort(within, axis=2)[:, :, 1:])  # the first is the distance to itself


def similarity(within_image_mm: Array, within_physical_mm: Array, tolerance_mm: Array) -> Indices:
    """Count matches (b, n, m) within e (b,) of sorted image (b, n, k) and physical distances (b, m, l).

    All cells walk along their two sorted rows in parallel; of two distances that differ by more than e, the
    shorter is skipped.
    """
    # A trailing infinity stops a walk at the end of its row; infinities of opposite sign never match.
    image = np.pad(within_image_mm, ((0, 0), (0, 0), (0, 1)), constant_values=NO_IMAGE_DISTANCE)
    physical = np.pad(within_physical_mm, ((0, 0), (0, 0), (0, 1)), constant_values=NO_PHYSICAL_DISTANCE)
    batch, rows, length = image.shape
    columns, width = physical.shape[1:]
    at_image = np.arange(batch * rows).reshape(batch, rows, 1) * length + np.zeros(columns, dtype=np.intp)
    at_physical = np.arange(batch * columns).reshape(batch, 1, columns) * width
    at_physical = at_physical + np.zeros((rows, 1), dtype=np.intp)
    tolerance = tolerance_mm[:, None, None]
    end_image, end_physical = at_image + length - 1, at_physical + width - 1
    found = np.zeros((batch, rows, columns), dtype=np.intp)
    flat_image, flat_physical = image.ravel(), physical.ravel()
    for _ in range(length + width - 2):
        difference = flat_image.take(at_image) - flat_physical.take(at_physical)
        not_longer, not_shorter = difference <= tolerance, difference >= -tolerance
        found += not_longer & not_shorter
        at_image += not_longer
        at_physical += not_shorter
        np.minimum(at_image, end_image, out=at_image)
        np.minimum(at_physical, end_physical, out=at_physical)
    return found


def similarity_to_any(within_image_mm: Array, within_physical_mm: Array, tolerance_mm: Array) -> Indices:
    """Count the image distances (b, n, k) with any counterpart within e (b,) among (b, m, l): (b, n, m)."""
    apart = np.abs(within_image_mm[:, :, None, :, None] - within_physical_mm[:, None, :, None, :])
    return np.asarray((apart <= tolerance_mm[:, None, None, None, None]).any(axis=4).sum(axis=3))
