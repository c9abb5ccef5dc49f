"""The error predicted while a plan is drawn, against independent formulas and random draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.planning.target_error import USUAL_SEATING_MM, predicted_by_markers
from procedures.registration.error_theory import tre_principal_axes_mm

MARKERS_MM = np.array([[60.0, -40.0, 60.0], [-50.0, -45.0, 55.0], [5.0, 40.0, 80.0], [-60.0, 20.0, 70.0]])
TARGET_MM = (5.0, -20.0, 20.0)


def test_equal_markers_give_the_error_of_fitzpatricks_formula() -> None:
    own_mm = 0.1  # 3-D rms
    covariances = np.tile(np.eye(3) * own_mm**2 / 3.0, (4, 1, 1))
    fle_mm = float(np.sqrt(own_mm**2 + 3.0 * USUAL_SEATING_MM**2))
    (by_formula,) = tre_principal_axes_mm(np.array([TARGET_MM]), MARKERS_MM, fle_mm)
    assert predicted_by_markers(MARKERS_MM, covariances, TARGET_MM).rms_mm == pytest.approx(
        by_formula, rel=1e-6
    )


def test_unequal_markers_give_the_error_of_many_random_draws() -> None:
    random = np.random.default_rng(5)
    covariances = np.stack([np.diag(random.uniform(0.001, 0.09, 3)) for _ in MARKERS_MM])
    seated = covariances + np.eye(3) * USUAL_SEATING_MM**2
    roots = np.linalg.cholesky(seated)
    errors = []
    middle = MARKERS_MM.mean(axis=0)
    for _ in range(2000):
        moved = MARKERS_MM + np.einsum("nij,nj->ni", roots, random.standard_normal((4, 3)))
        turn, _ = Rotation.align_vectors(moved - moved.mean(axis=0), MARKERS_MM - middle)
        errors.append(turn.apply(np.array(TARGET_MM) - middle) + moved.mean(axis=0) - TARGET_MM)
    drawn_mm = float(np.sqrt(np.square(errors).sum(axis=1).mean()))
    assert predicted_by_markers(MARKERS_MM, covariances, TARGET_MM).rms_mm == pytest.approx(
        drawn_mm, rel=0.06
    )
