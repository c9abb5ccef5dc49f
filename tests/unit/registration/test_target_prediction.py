"""Prediction with shared errors: which cancel, how the rest passes through the fit, and the error region."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.registration import register
from procedures.registration.target_prediction import (
    OwnErrors,
    SharedErrors,
    influence_of_spheres,
    predict_target_error,
)

SPHERES = np.array([[80.0, 0, 0], [0, 90, 20], [-70, -10, 40], [10, -80, 0]])
TARGET = np.array([5.0, 10.0, -40.0])
NOTHING = np.zeros((3, 3))


def test_an_error_that_displaces_all_poses_alike_cancels() -> None:
    shift = SharedErrors("tool frame", np.tile(2.0 * np.eye(3), (4, 1, 1)), 2.0 * np.eye(3))
    assert predict_target_error(SPHERES, TARGET, [shift]).rms_mm == pytest.approx(0.0, abs=1e-12)


def test_an_error_that_turns_all_poses_about_the_base_cancels_too() -> None:
    def turned(point: np.ndarray) -> np.ndarray:
        return np.cross([0.0, 0.0, 1e-3], point)[:, None]

    turn = SharedErrors("first joint", np.array([turned(one) for one in SPHERES]), turned(TARGET))
    assert predict_target_error(SPHERES, TARGET, [turn]).rms_mm == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_displaced_sphere_moves_the_target_as_the_fit_says(weighted: bool) -> None:
    own = np.array([np.diag([0.01, 0.02, 0.09]), *(np.diag([0.01, 0.01, 0.01]) for _ in range(3))])
    influence = influence_of_spheres(SPHERES, TARGET, np.linalg.inv(own) if weighted else None)
    step_mm = 1e-3
    for sphere in range(4):
        for axis in range(3):
            recorded = SPHERES.copy()
            recorded[sphere, axis] += step_mm
            fit = register(SPHERES, recorded, covariance_mm2=own if weighted else None)
            moved = (fit.transform.apply(TARGET) - TARGET) / step_mm
            np.testing.assert_allclose(moved, influence[sphere, :, axis], atol=1e-4)


def test_the_region_contains_the_errors_of_many_registrations() -> None:
    random = np.random.default_rng(5)
    own = np.tile(np.diag([0.01, 0.02, 0.09]), (4, 1, 1))
    columns = 0.1 * random.normal(size=(5, 3, 2))
    predicted = predict_target_error(
        SPHERES, TARGET, [SharedErrors("arm", columns[:4], columns[4]), OwnErrors("CT", own, NOTHING)]
    )
    errors = []
    for _ in range(800):
        size = random.normal(size=2)
        noise = np.einsum("nij,nj->ni", np.linalg.cholesky(own), random.normal(size=(4, 3)))
        fit = register(SPHERES, SPHERES - columns[:4] @ size + noise)
        errors.append(fit.transform.apply(TARGET) + columns[4] @ size - TARGET)
    np.testing.assert_allclose(np.cov(np.array(errors).T), predicted.covariance_mm2, atol=0.01)
    assert predicted.holds(errors).mean() == pytest.approx(0.95, abs=0.02)
    assert sum(share**2 for share in predicted.budget_mm.values()) == pytest.approx(predicted.rms_mm**2)
