"""Strays without identity are grouped over the frames and averaged."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.registration.errors import BadParameter, BadPoints
from procedures.registration.strays import group_strays

NOISE_MM = np.array([0.04, 0.04, 0.14])


@pytest.fixture
def spheres(fiducials, random):
    return fiducials(5, random)


def noisy_frames(spheres, random, count=60):
    """Each frame in another order."""
    return [random.permutation(spheres + random.normal(size=spheres.shape) * NOISE_MM) for _ in range(count)]


def test_each_sphere_becomes_one_group_with_a_better_mean(spheres, random):
    groups = group_strays(noisy_frames(spheres, random))
    assert len(groups) == 5
    for group in groups:
        assert group.count == 60
        assert np.linalg.norm(spheres - group.mean_mm, axis=1).min() < 4 * NOISE_MM.max() / np.sqrt(60)
        assert group.spread_mm == pytest.approx(np.linalg.norm(NOISE_MM), rel=0.3)
        assert np.sqrt(np.diag(group.covariance_mm2)) == pytest.approx(NOISE_MM, rel=0.4)


@pytest.mark.hazard(14)
def test_a_flickering_reflection_is_left_out_and_an_occluded_sphere_kept(spheres, random):
    frames = noisy_frames(spheres, random)
    frames = [np.vstack([f, [[500.0, 0.0, 0.0]]]) if k % 3 == 0 else f for k, f in enumerate(frames)]
    frames = [
        f[np.linalg.norm(f - spheres[0], axis=1) > 5.0] if 20 <= k < 45 else f for k, f in enumerate(frames)
    ]
    groups = group_strays(frames)
    assert sorted(group.count for group in groups) == [35, 60, 60, 60, 60]


def test_two_spheres_that_touch_stay_two(random):
    pair = np.array([[0.0, 0.0, 0.0], [11.5, 0.0, 0.0]])
    assert [group.count for group in group_strays(noisy_frames(pair, random))] == [60, 60]


def test_a_single_outlier_does_not_shift_the_mean_but_shows_in_the_spread(random):
    sphere = np.zeros((1, 3))
    frames = noisy_frames(sphere, random)
    frames[30] = np.array([[3.0, 0.0, 0.0]])
    (group,) = group_strays(frames)
    assert group.outliers == 1
    assert np.linalg.norm(group.mean_mm) < 0.1
    assert group.spread_mm > 0.3


def test_still_readings_have_no_spread():
    (group,) = group_strays([[[1.0, 2.0, 3.0]]] * 10)
    assert group.mean_mm.tolist() == [1.0, 2.0, 3.0]
    assert group.spread_mm == 0.0
    assert group.outliers == 0


def test_no_strays_are_no_groups():
    assert group_strays([]) == ()
    assert group_strays([np.zeros((0, 3))] * 5) == ()


def test_bad_readings_and_parameters_are_refused():
    with pytest.raises(BadPoints, match="REG-001"):
        group_strays([[[np.nan, 0.0, 0.0]]])
    with pytest.raises(BadParameter, match="REG-007"):
        group_strays([], radius_mm=0.0)
