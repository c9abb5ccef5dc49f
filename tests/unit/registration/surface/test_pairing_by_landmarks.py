"""Up to three spheres are paired with readings of the tracker by landmarks, or the pairing is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.surface.starts import LANDMARK_SD_MM, Start, pair_spheres
from ronna_hw.errors import RonnaError

LANDMARKS_MM = np.array([[0.0, -95.0, -40.0], [78.0, 5.0, -42.0], [-78.0, 5.0, -42.0]])
SCREWS_MM = np.array([[30.0, -30.0, 85.0], [-55.0, 40.0, 70.0], [-20.0, -80.0, 55.0]])
STRAYS_MM = np.array([[300.0, 40.0, 20.0], [-400.0, 0.0, 100.0]])
ROBOT_FROM_CT = RigidTransform.from_components([700.0, 50.0, 200.0], Rotation.from_rotvec([0.2, 1.1, -0.4]))


def touched(seed):
    """Landmarks as touched, and the start by them."""
    noise = np.random.default_rng(seed).normal(size=(3, 3)) * LANDMARK_SD_MM
    there = ROBOT_FROM_CT.apply(LANDMARKS_MM) + noise
    return there, Start.from_landmarks(LANDMARKS_MM, there)


def pair(seed, seen_mm, count):
    landmarks_mm, start = touched(seed)
    return pair_spheres(start, LANDMARKS_MM, landmarks_mm, SCREWS_MM[:count], seen_mm)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_each_sphere_finds_its_reading_among_strays_and_makes_the_start_better(count):
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(count + len(STRAYS_MM))
        seen_mm = ROBOT_FROM_CT.apply(np.vstack([SCREWS_MM[:count], STRAYS_MM]))[order]
        found = pair(seed, seen_mm, count)
        assert [order[row] for _, row in found.pairs] == list(range(count))
        assert max(found.residuals_mm) < 1.0
        apart_mm = found.robot_from_ct.apply(SCREWS_MM[:count]) - ROBOT_FROM_CT.apply(SCREWS_MM[:count])
        assert np.linalg.norm(apart_mm, axis=1).max() < 1.0


def test_a_head_without_spheres_keeps_the_start_of_its_landmarks():
    _, start = touched(0)
    assert pair_spheres(start, LANDMARKS_MM, LANDMARKS_MM, np.empty((0, 3)), STRAYS_MM).robot_from_ct is (
        start.robot_from_ct
    )


@pytest.mark.branch("UNPAIRED_BESIDE_SKIN")
@pytest.mark.parametrize(
    ("seen_mm", "count", "words"),
    [
        (SCREWS_MM[:1], 2, "sees nothing where nose and ears put sphere 2"),
        (np.vstack([SCREWS_MM[0], SCREWS_MM[0] + (6.0, 6.0, 0.0)]), 1, "cannot be told"),
        (np.vstack([SCREWS_MM[0], SCREWS_MM[1] + (14.0, 0.0, 8.0)]), 2, "elsewhere"),
    ],
)
def test_a_missing_a_doubled_and_a_displaced_sphere_are_refused(seen_mm, count, words):
    with pytest.raises(RonnaError, match=words) as refusal:
        pair(1, ROBOT_FROM_CT.apply(seen_mm), count)
    assert refusal.value.code == "SRF-013"
