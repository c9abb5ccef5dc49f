"""The thesis pairing, checked against the stated errors of both devices."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.registration.correspondence import MatchStatus
from procedures.registration.similarity_matrix import (
    REFUSED_SHARE,
    SimilarityPairs,
    match_many_by_similarity,
    validate_many,
)

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
