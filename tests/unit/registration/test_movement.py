"""How a body moved, and how well that is known."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.movement import RigidMove, fit_rigid_move

SPHERES_MM = np.array([[0, 0, 80], [60, 0, 50], [-60, 10, 50], [10, 70, 30], [0, -70, 40]], dtype=float)
SIGMA_MM = np.array([0.03, 0.03, 0.1])  # a tracker is worse in depth
COVARIANCE_MM2 = np.tile(np.diag(2.0 * SIGMA_MM**2), (len(SPHERES_MM), 1, 1))
TARGET_MM = np.array([20.0, 10.0, -20.0])
MOVE = RigidTransform.from_components([1.0, -2.0, 0.5], Rotation.from_rotvec([0.0, 0.3, 0.6], degrees=True))
TRIALS = 400
MOVED_TRIALS = 40


def measured(generator: np.random.Generator, places_mm: np.ndarray) -> np.ndarray:
    return np.asarray(places_mm + SIGMA_MM * generator.standard_normal(places_mm.shape))


@pytest.fixture(scope="module")
def moves() -> list[RigidMove]:
    """The same move measured again and again."""
    generator = np.random.default_rng(5)
    return [
        fit_rigid_move(
            measured(generator, SPHERES_MM), measured(generator, MOVE.apply(SPHERES_MM)), COVARIANCE_MM2
        )
        for _ in range(TRIALS)
    ]


def test_the_predicted_error_of_a_followed_point_matches_its_scatter(moves: list[RigidMove]) -> None:
    errors_mm = [np.linalg.norm(one.fit.transform.apply(TARGET_MM) - MOVE.apply(TARGET_MM)) for one in moves]
    told_mm = [one.error_mm(TARGET_MM) for one in moves]
    assert np.sqrt(np.mean(np.square(errors_mm))) == pytest.approx(np.mean(told_mm), rel=0.1)
    assert [one.way_mm for one in moves] == pytest.approx([2.3] * TRIALS, abs=0.3)


def test_noise_rarely_fails_the_gate(moves: list[RigidMove]) -> None:
    assert np.mean([one.gate.passed for one in moves]) >= 0.99


def test_a_sphere_that_moved_on_its_own_fails_the_gate() -> None:
    generator = np.random.default_rng(6)
    for _ in range(MOVED_TRIALS):
        before, after = measured(generator, SPHERES_MM), measured(generator, MOVE.apply(SPHERES_MM))
        after[0] += (1.0, 0.0, 0.0)  # far beyond its noise, in every trial
        assert not fit_rigid_move(before, after, COVARIANCE_MM2).gate.passed
