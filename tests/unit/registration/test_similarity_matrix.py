"""The thesis correspondence as a baseline: it pairs easy sets and fails where the thesis says it does."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from procedures.registration import MatchStatus
from procedures.registration.similarity_matrix import (
    SimilarityPairs,
    match_many_by_similarity,
    similarity,
    validate_many,
)
from procedures.registration.thesis_settings import REFUSED_SHARE


def matched_one_to_one(a, b, tolerance_mm: float) -> int:
    """The largest one-to-one matching of two short lists, by trying all."""
    short, long = sorted((list(a), list(b)), key=len)
    best = 0
    for chosen in itertools.permutations(long, len(short)):
        best = max(best, sum(abs(x - y) <= tolerance_mm for x, y in zip(short, chosen, strict=True)))
    return best


def test_a_cell_counts_the_largest_one_to_one_matching_of_distances(random):
    image = np.sort(random.uniform(0, 20, (6, 3, 4)), axis=2)
    physical = np.sort(random.uniform(0, 20, (6, 5, 3)), axis=2)
    matrices = similarity(image, physical, np.full(6, 2.0))
    for k, i, j in np.ndindex(6, 3, 5):
        assert matrices[k, i, j] == matched_one_to_one(image[k, i], physical[k, j], 2.0)


def one(image, physical, tolerance_mm: float = 3.0):
    (found,) = match_many_by_similarity(image[None], physical[None], np.array([tolerance_mm]))
    return found


def test_a_head_with_outliers_is_paired(random, fiducials, reading):
    seen = reading(fiducials(6, random), 2, random)
    found = one(seen.image_mm, seen.physical_mm)
    assert found.status is MatchStatus.UNIQUE
    assert set(map(tuple, found.pairs.tolist())) == seen.pairs


def test_batched_readings_give_the_same_result_as_one_by_one(random, fiducials, reading):
    seen = [reading(fiducials(4, random), 3, random) for _ in range(30)]
    images, physicals = np.array([s.image_mm for s in seen]), np.array([s.physical_mm for s in seen])
    tolerances = random.uniform(1.0, 6.0, 30)
    together = match_many_by_similarity(images, physicals, tolerances)
    for found, image, physical, tolerance in zip(together, images, physicals, tolerances, strict=True):
        alone = one(image, physical, float(tolerance))
        assert (found.status, found.pairs.tolist()) == (alone.status, alone.pairs.tolist())


def test_equal_sides_are_ambiguous_and_unrelated_points_inconsistent(random, any_pose):
    triangle = np.array([[-50, 0, 0], [50, 0, 0], [0, 120, 10]], dtype=float)
    assert one(triangle, any_pose(random).apply(triangle)).status is MatchStatus.AMBIGUOUS
    far = one(random.normal(size=(4, 3)) * 100, random.normal(size=(4, 3)) * 100, 0.01)
    assert far.status is MatchStatus.INCONSISTENT


SIGMA_MM = 0.3


def test_a_swapped_pair_is_refused_and_the_true_pairs_are_kept(random, fiducials, any_pose):
    points = fiducials(5, random)
    seen = any_pose(random).apply(points) + random.normal(size=points.shape) * SIGMA_MM
    true = np.column_stack([np.arange(5)] * 2)
    swapped = true.copy()
    swapped[[0, 1], 1] = swapped[[1, 0], 1]
    found = [SimilarityPairs(MatchStatus.UNIQUE, pairs) for pairs in (true, swapped)]
    kept, refused = validate_many(np.array([points] * 2), np.array([seen] * 2), found, SIGMA_MM**2)
    assert kept is found[0]
    assert (refused.status, len(refused.pairs)) == (MatchStatus.INCONSISTENT, 0)


@pytest.mark.parametrize("count", [3, 8])
def test_true_pairings_are_refused_no_more_often_than_stated(random, fiducials, count):
    runs = 4000
    points = np.array([fiducials(count, random)] * runs)
    seen = points + random.normal(size=points.shape) * SIGMA_MM
    true = SimilarityPairs(MatchStatus.UNIQUE, np.column_stack([np.arange(count)] * 2))
    judged = validate_many(points, seen, [true] * runs, SIGMA_MM**2)
    refused = sum(one.status is MatchStatus.INCONSISTENT for one in judged)
    assert refused <= REFUSED_SHARE * runs + 5


def test_a_pairing_that_was_not_found_stays_unchanged(random):
    image, physical = random.normal(size=(2, 4, 3)) * 100, random.normal(size=(2, 5, 3)) * 100
    found = match_many_by_similarity(image, physical, np.full(2, 0.01))
    assert validate_many(image, physical, found, SIGMA_MM**2) == found
