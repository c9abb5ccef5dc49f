"""The similarity matrices as baselines: they pair easy sets and fail where the thesis says they do."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from procedures.registration import MatchStatus
from procedures.registration.gradual_matrix import match_many_gradually
from procedures.registration.similarity_matrix import (
    SimilarityPairs,
    match_many_by_similarity,
    similarity,
    similarity_steps,
)
from procedures.registration.thesis_matching import validate_many
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


def as_written(images, physicals, tolerances_mm, markers):
    return match_many_by_similarity(images, physicals, tolerances_mm, markers)


def gradually(images, physicals, tolerances_mm, markers):
    return match_many_gradually(images, physicals, tolerances_mm)


MATRICES = pytest.mark.parametrize("match_many", [as_written, gradually])


def one(match_many, image, physical, markers, tolerance_mm: float = 3.0):
    (found,) = match_many(image[None], physical[None], np.array([tolerance_mm]), markers)
    return found


@MATRICES
def test_a_head_with_outliers_is_paired(random, fiducials, reading, match_many):
    seen = reading(fiducials(6, random), 2, random)
    found = one(match_many, seen.image_mm, seen.physical_mm, 6)
    assert found.status is MatchStatus.UNIQUE
    assert set(map(tuple, found.pairs.tolist())) == seen.pairs


@MATRICES
def test_batched_readings_give_the_same_result_as_one_by_one(random, fiducials, reading, match_many):
    seen = [reading(fiducials(4, random), 3, random) for _ in range(30)]
    images, physicals = np.array([s.image_mm for s in seen]), np.array([s.physical_mm for s in seen])
    tolerances = random.uniform(1.0, 6.0, 30)
    together = match_many(images, physicals, tolerances, 4)
    assert len({found.status for found in together}) > 1
    for found, image, physical, tolerance in zip(together, images, physicals, tolerances, strict=True):
        alone = one(match_many, image, physical, 4, float(tolerance))
        assert (found.status, found.pairs.tolist()) == (alone.status, alone.pairs.tolist())


@MATRICES
def test_equal_sides_are_ambiguous_and_unrelated_points_inconsistent(random, any_pose, match_many):
    triangle = np.array([[-50, 0, 0], [50, 0, 0], [0, 120, 10]], dtype=float)
    assert one(match_many, triangle, any_pose(random).apply(triangle), 3).status is MatchStatus.AMBIGUOUS
    far = one(match_many, random.normal(size=(4, 3)) * 100, random.normal(size=(4, 3)) * 100, 4, 0.01)
    assert far.status is MatchStatus.INCONSISTENT


def test_every_failing_row_and_column_is_removed_at_once(random, fiducials, any_pose, ball):
    head, strays = fiducials(5, random), 1000.0 + ball(6, 300.0, random)
    image, physical = np.vstack([head, strays[:4]]), any_pose(random).apply(np.vstack([head, strays[4:]]))
    steps, found = similarity_steps(image, physical, 0.5, 5)
    assert [step.matrix.shape for step in steps] == [(9, 7), (5, 5)]
    assert np.array_equal(steps[1].matrix, np.where(np.eye(5), 4, steps[1].matrix))
    assert found.pairs.tolist() == [[k, k] for k in range(5)]


def test_a_distance_that_disagrees_costs_the_pairing_as_written_and_one_marker_gradually(random, fiducials):
    head = fiducials(6, random)
    along = (head[1] - head[0]) / np.linalg.norm(head[1] - head[0])
    moved = head.copy()
    moved[0] -= 4.0 * along
    distance = np.abs(
        np.linalg.norm(head[:, None] - head, axis=2) - np.linalg.norm(moved[:, None] - moved, axis=2)
    )
    e_mm = float(np.sort(distance[0])[-2:].mean())  # only the largest difference is beyond it
    written, gradual = (one(rule, head, moved, 6, e_mm) for rule in (as_written, gradually))
    assert written.status is MatchStatus.INCONSISTENT
    assert [i == j for i, j in gradual.pairs.tolist()] == [True] * 5


def test_points_that_agree_beyond_the_number_of_markers_are_ambiguous(random, fiducials, any_pose):
    head = fiducials(6, random)
    assert one(as_written, head, any_pose(random).apply(head), 5, 0.5).status is MatchStatus.AMBIGUOUS


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
    found = match_many_by_similarity(image, physical, np.full(2, 0.01), 4)
    assert validate_many(image, physical, found, SIGMA_MM**2) == found
