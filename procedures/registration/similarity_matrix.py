"""Similarity matrix correspondence as in the thesis, validated: a baseline, not for clinical use.

Cell (i, j) counts the distances from image point i that equal one from physical point j within e. Points
whose best cell is lowest are dropped one by one until all remaining points agree with each other, or too few
remain. The thesis leaves open how a cell is matched and what is dropped when: here distances are matched one
to one in order of length, and the single worst point of the larger set goes first (of both sets, if equally
large). Dropping all failing points at once fails far more often.

The thesis says that the known errors of both sets validate a successful pairing (5.3), but not how. Here the
pairs are fitted, and the sum of squared residuals must not exceed what the stated standard deviations
explain.

The text can also be read such that a distance counts whenever *any* of the other point's matches it
(`Counting.ANY`). Two similar distances then make two points similar, which limits e from above.

Many readings with equally many points are solved at once, because a study repeats this millions of times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.registration.correspondence import Hypothesis, Match, MatchStatus, PosePrior
from procedures.registration.matching import weigh_evidence
from procedures.registration.pairings import LINE_RATIO, gate
from procedures.registration.points import FEWEST_PAIRS, validate_points
from procedures.registration.rigid_fit import as_transform, fit_rigid, residuals
from procedures.registration.thesis_settings import REFUSED_SHARE, check_thesis_settings
from ronna_hw.arrays import Array

Indices = NDArray[np.intp]


class Counting(StrEnum):
    """How a cell counts: every distance at most once, or each that has any counterpart."""

    ONE_TO_ONE = "one to one"
    ANY = "with any counterpart"


@dataclass(frozen=True)
class SimilarityPairs:
    """Result for one reading: pairs (k, 2) if UNIQUE, otherwise none."""

    status: MatchStatus
    pairs: Indices


def match_many_by_similarity(
    image_mm: Array, physical_mm: Array, tolerance_mm: Array, counting: Counting = Counting.ONE_TO_ONE
) -> tuple[SimilarityPairs, ...]:
    """Pair image points (b, n, 3) with physical points (b, m, 3), in mm, by the rule of the thesis.

    Each reading has its own e (b,), mm; n and m are at least 3. UNIQUE when every remaining point has exactly
    one partner, AMBIGUOUS when some have several, else INCONSISTENT.
    """
    found: dict[int, SimilarityPairs] = {}
    for readings, matrix in _iterate_matrices(image_mm, physical_mm, tolerance_mm, counting):
        found |= readings.settle(matrix)
    return tuple(found[one] for one in range(len(image_mm)))


@dataclass(frozen=True)
class SimilarityStep:
    """One iteration: the remaining image and physical points, and the matrix between them."""

    rows: Indices
    columns: Indices
    matrix: Indices


def similarity_steps(
    image_mm: Array, physical_mm: Array, tolerance_mm: float
) -> tuple[tuple[SimilarityStep, ...], SimilarityPairs]:
    """Return every iteration of one reading, points (n, 3) and (m, 3) in mm, and its result."""
    steps: list[SimilarityStep] = []
    found: dict[int, SimilarityPairs] = {}
    for readings, matrix in _iterate_matrices(
        image_mm[None], physical_mm[None], np.array([tolerance_mm]), Counting.ONE_TO_ONE
    ):
        steps.append(SimilarityStep(readings.rows[0], readings.columns[0], matrix[0]))
        found |= readings.settle(matrix)
    return tuple(steps), found[0]


def _iterate_matrices(
    image_mm: Array, physical_mm: Array, tolerance_mm: Array, counting: Counting
) -> Iterator[tuple[_Readings, Indices]]:
    """Yield readings with equally many remaining points, and their matrices, until all are settled."""
    image, physical = _distances(image_mm), _distances(physical_mm)
    count = similarity if counting is Counting.ONE_TO_ONE else similarity_to_any
    for readings in _iterate_groups(image, physical):
        rows = _sort_rows(image[readings.index], readings.rows)
        columns = _sort_rows(physical[readings.index], readings.columns)
        yield readings, count(rows, columns, tolerance_mm[readings.index])


def similarity(within_image_mm: Array, within_physical_mm: Array, tolerance_mm: Array) -> Indices:
    """Count matches (b, n, m) within e (b,) of sorted image (b, n, k) and physical distances (b, m, l).

    All cells walk along their two sorted rows in parallel; of two distances that differ by more than e, the
    shorter is skipped.
    """
    # A trailing infinity stops a walk at the end of its row; infinities of opposite sign never match.
    image = np.pad(within_image_mm, ((0, 0), (0, 0), (0, 1)), constant_values=np.inf)
    physical = np.pad(within_physical_mm, ((0, 0), (0, 0), (0, 1)), constant_values=1e300)
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
            status, pairs = MatchStatus.AMBIGUOUS, _no_pairs()
            if single[k]:
                status = MatchStatus.UNIQUE
                pairs = np.column_stack([self.rows[k], self.columns[k][complete[k].argmax(axis=1)]])
            settled[int(self.index[k])] = SimilarityPairs(status, pairs)
        rest = np.flatnonzero(~is_settled)
        if min(r, c) <= FEWEST_PAIRS and r == c:
            return settled | {
                int(self.index[k]): SimilarityPairs(MatchStatus.INCONSISTENT, _no_pairs()) for k in rest
            }
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


def _iterate_groups(image_mm: Array, physical_mm: Array) -> Iterator[_Readings]:
    """Yield readings grouped by size, largest first, until none remain."""
    batch, n, m = len(image_mm), image_mm.shape[1], physical_mm.shape[1]
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


def _distances(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points[:, :, None] - points[:, None], axis=-1))


def _sort_rows(distances: Array, kept: Indices) -> Array:
    """Sort the distances from each kept point to the other kept points."""
    chosen = np.take_along_axis(distances, kept[:, :, None], axis=1)
    chosen = np.take_along_axis(chosen, kept[:, None, :], axis=2)
    return np.asarray(np.sort(chosen, axis=2)[:, :, 1:])  # the first is the distance to itself


def _no_pairs() -> Indices:
    return np.empty((0, 2), dtype=np.intp)


def validate_many(
    image_mm: Array,
    physical_mm: Array,
    found: Sequence[SimilarityPairs],
    variance_mm2: float,
    refused_share: float = REFUSED_SHARE,
) -> tuple[SimilarityPairs, ...]:
    """Check pairings of image (b, n, 3) and physical points (b, m, 3), mm, against the stated errors.

    `variance_mm2` is the stated variance per axis of both sets together. A UNIQUE pairing whose residuals
    are larger than those of all but `refused_share` of the correct ones becomes INCONSISTENT; the others are
    returned unchanged.
    """
    by_size: dict[int, list[int]] = {}
    for number, one in enumerate(found):
        if one.status is MatchStatus.UNIQUE:
            by_size.setdefault(len(one.pairs), []).append(number)
    judged = list(found)
    for size, numbers in by_size.items():
        pairs = np.array([found[number].pairs for number in numbers])
        image = np.take_along_axis(image_mm[numbers], pairs[:, :, :1], axis=1)
        physical = np.take_along_axis(physical_mm[numbers], pairs[:, :, 1:], axis=1)
        rest = residuals(fit_rigid(image, physical), image, physical)
        too_large = np.square(rest).sum(axis=(1, 2)) > gate(size, refused_share) * variance_mm2
        for number in np.array(numbers)[too_large].tolist():
            judged[number] = SimilarityPairs(MatchStatus.INCONSISTENT, _no_pairs())
    return tuple(judged)


def match_as_thesis(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    e_mm: float,
    sigma_image_mm: float,
    sigma_physical_mm: float,
    refused_share: float,
    expected: int | None = None,
    prior: PosePrior | None = None,
) -> Match:
    """Pair image points (n, 3) with physical points (m, 3), in mm, in the form of `match`.

    The method counts matching distances. It weighs no rival pairing, so it states no odds: `margin_nats` and
    the score are None. It knows neither the number of markers nor the patient's position: with those its
    pairing can only be refused. Raises REG-001 and REG-007.
    """
    image, physical = validate_points(image_mm, "image"), validate_points(physical_mm, "physical")
    variance_mm2 = weigh_evidence(sigma_image_mm, sigma_physical_mm).variance_mm2
    check_thesis_settings(e_mm, refused_share)
    counts = len(image), len(physical)
    fewest = expected or FEWEST_PAIRS
    if min(counts) < fewest:
        sizes = f"{counts[0]} image and {counts[1]} physical points, {fewest} needed"
        return Match.of(MatchStatus.TOO_FEW, sizes, None, counts, margin_nats=None)
    stacked = image[None], physical[None]
    (raw,) = match_many_by_similarity(*stacked, np.array([e_mm]))
    (found,) = validate_many(*stacked, [raw], variance_mm2, refused_share)
    if found.status is not MatchStatus.UNIQUE:
        return Match.of(found.status, _explain(raw, e_mm), None, counts, margin_nats=None)
    pairs = found.pairs[np.argsort(found.pairs[:, 0])]
    of_image, of_physical = image[pairs[:, 0]], physical[pairs[:, 1]]
    fit = fit_rigid(of_image, of_physical)
    objection = ""
    if expected is not None and len(pairs) != expected:
        objection = f"{len(pairs)} pairs agree, {expected} expected"
    elif fit.spread_mm2[1] <= LINE_RATIO * fit.spread_mm2[0]:
        objection = f"the {len(pairs)} agreeing points are collinear and do not determine the rotation"
    elif prior is not None and (why := prior.objection(fit.rotation, fit.translation_mm, of_physical)):
        objection = f"the points agree only in an orientation that the prior excludes: {why}"
    hypothesis = Hypothesis(
        pairs,
        as_transform(fit.rotation, fit.translation_mm),
        float(np.square(residuals(fit, of_image, of_physical)).sum()) / variance_mm2,
        gate(len(pairs), refused_share),
        None,
    )
    if objection:
        return Match.of(
            MatchStatus.INCONSISTENT, objection, None, counts, runner_up=hypothesis, margin_nats=None
        )
    reason = f"{len(pairs)} pairs agree within e = {e_mm:g} mm"
    return Match.of(MatchStatus.UNIQUE, reason, hypothesis, counts, margin_nats=None)


def _explain(raw: SimilarityPairs, e_mm: float) -> str:
    if raw.status is MatchStatus.UNIQUE:
        return f"{len(raw.pairs)} pairs agree within e = {e_mm:g} mm, but with residuals beyond the noise"
    if raw.status is MatchStatus.AMBIGUOUS:
        return f"within e = {e_mm:g} mm some spheres have more than one partner"
    return f"no three points have matching distances within e = {e_mm:g} mm"
