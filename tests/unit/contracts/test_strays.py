"""Unidentified stray markers are grouped over the frames and averaged."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.devices.errors import BadStrays
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity
from ronna_hw.devices.strays import average_strays, group_strays

NOISE_MM = np.array([0.04, 0.04, 0.14])


@pytest.fixture
def random():
    return np.random.default_rng(11)


@pytest.fixture
def spheres():
    return np.array([[0.0, 0, -1500], [60, 10, -1480], [-40, 55, -1520], [20, -70, -1490], [-75, -20, -1510]])


def noisy_frames(spheres, random, count=60):
    """Each frame in another order."""
    return [random.permutation(spheres + random.normal(size=spheres.shape) * NOISE_MM) for _ in range(count)]


def test_each_sphere_becomes_one_group_with_a_better_mean(spheres, random):
    groups = group_strays(noisy_frames(spheres, random)).groups
    assert len(groups) == 5
    for group in groups:
        assert group.count == 60
        assert np.linalg.norm(spheres - group.mean_mm, axis=1).min() < 4 * NOISE_MM.max() / np.sqrt(60)
        assert group.spread_mm == pytest.approx(np.linalg.norm(NOISE_MM), rel=0.3)
        assert np.sqrt(np.diag(group.covariance_mm2)) == pytest.approx(NOISE_MM, rel=0.4)


@pytest.mark.hazard(14)
def test_a_flickering_reflection_is_rejected_and_an_occluded_sphere_kept(spheres, random):
    frames = noisy_frames(spheres, random)
    frames = [np.vstack([f, [[500.0, 0.0, 0.0]]]) if k % 3 == 0 else f for k, f in enumerate(frames)]
    frames = [
        f[np.linalg.norm(f - spheres[0], axis=1) > 5.0] if 20 <= k < 45 else f for k, f in enumerate(frames)
    ]
    average = group_strays(frames)
    assert sorted(group.count for group in average.groups) == [35, 60, 60, 60, 60]
    assert [group.count for group in average.rejected] == [20]


def test_two_touching_spheres_stay_separate(random):
    pair = np.array([[0.0, 0.0, 0.0], [11.5, 0.0, 0.0]])
    assert [group.count for group in group_strays(noisy_frames(pair, random)).groups] == [60, 60]


def test_a_single_outlier_does_not_shift_the_mean_but_shows_in_the_spread(random):
    sphere = np.zeros((1, 3))
    frames = noisy_frames(sphere, random)
    frames[30] = np.array([[3.0, 0.0, 0.0]])
    (group,) = group_strays(frames).groups
    assert group.outliers == 1
    assert np.linalg.norm(group.mean_mm) < 0.1
    assert group.spread_mm > 0.3


def test_identical_readings_have_zero_spread():
    (group,) = group_strays([[(1.0, 2.0, 3.0)]] * 10).groups
    assert group.mean_mm.tolist() == [1.0, 2.0, 3.0]
    assert group.spread_mm == 0.0
    assert group.outliers == 0


def test_no_strays_give_no_groups():
    assert group_strays([]).groups == ()
    assert group_strays([np.zeros((0, 3))] * 5).groups == ()


def test_only_strays_inside_the_volume_and_new_measurements_are_averaged():
    def frame(number, *strays, validity=Validity.OK):
        return TrackerFrame(Stamp(number, number, number / 60), validity, (), strays)

    inside = StrayReading((0.0, 0.0, -1500.0), Validity.OK)
    outside = StrayReading((0.0, 0.0, -3500.0), Validity.OUT_OF_VOLUME)
    frames = [frame(k, inside, outside) for k in range(10)]
    average = average_strays([*frames, frame(9, inside, outside, validity=Validity.STALE)])
    assert average.frames == 10
    assert [group.count for group in average.groups] == [10]
    assert average.groups[0].mean_mm.tolist() == [0.0, 0.0, -1500.0]


@pytest.mark.parametrize(
    ("frames", "wish"),
    [
        ([[(np.nan, 0.0, 0.0)]], {}),
        ([[(1.0, 2.0)]], {}),
        ([[1.0, 2.0, 3.0]], {}),
        ([], {"radius_mm": 0.0}),
        ([], {"least_share": 1.5}),
    ],
)
def test_invalid_positions_and_impossible_parameters_are_refused(frames, wish):
    with pytest.raises(BadStrays, match="DEV-005"):
        group_strays(frames, **wish)
