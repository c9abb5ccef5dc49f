"""The chi-square of residuals whose points share errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from procedures.registration import register
from procedures.registration.error_theory import FreGate, chi_square_limit
from procedures.registration.target_prediction import UnnoticedPoint, chi_square_of_shared, unnoticed_point

Array = NDArray[np.float64]

POINTS_MM = np.array([[60.0, 0, 10], [-50, 30, 0], [0, -60, 20], [20, 50, -40], [-30, -20, 50]])
SIGMA_MM = 0.1
COVARIANCE_MM2 = np.tile(np.eye(3) * SIGMA_MM**2, (5, 1, 1))


def test_the_chi_square_equals_that_of_the_fit_without_shared_errors() -> None:
    generator = np.random.default_rng(1)
    fit = register(POINTS_MM, POINTS_MM + generator.normal(0.0, 0.1, (5, 3)), covariance_mm2=COVARIANCE_MM2)
    mapped = fit.transform.apply(POINTS_MM)
    found = chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, np.zeros((5, 3, 1)))
    assert found == pytest.approx(fit.chi_square, rel=1e-3)


def test_residuals_with_shared_errors_follow_a_chi_square_distribution() -> None:
    generator = np.random.default_rng(2)
    shared_mm = generator.normal(0.0, 0.3, (5, 3, 2))
    shares = []
    for _ in range(1000):
        error_mm = generator.normal(0.0, SIGMA_MM, (5, 3)) + shared_mm @ generator.normal(size=2)
        fit = register(POINTS_MM, POINTS_MM + error_mm, covariance_mm2=COVARIANCE_MM2)
        mapped = fit.transform.apply(POINTS_MM)
        shares.append(
            chi2.cdf(chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, shared_mm), df=9)
        )
    assert np.mean(shares) == pytest.approx(0.5, abs=0.03)
    assert np.mean(np.array(shares) > 0.95) == pytest.approx(0.05, abs=0.02)


TARGET_MM = np.array([10.0, 20.0, -60.0])
LIMIT = chi_square_limit(9, 0.999)


def _worst(points_mm: Array, largest_mm: float = 3.0) -> UnnoticedPoint:
    count = len(points_mm)
    gate = FreGate(0.0, 0.0, chi_square_limit(3 * count - 6, 0.999), 0.999)
    covariance, shared = COVARIANCE_MM2[:count], np.zeros((count, 3, 1))
    return unnoticed_point(
        points_mm, TARGET_MM, covariance, shared, np.linalg.inv(covariance), gate, largest_mm
    )


def test_the_worst_point_displaced_as_stated_shifts_the_target_as_stated_and_passes_every_other_time() -> (
    None
):
    worst = _worst(POINTS_MM)
    generator = np.random.default_rng(3)
    found: list[tuple[float, Array]] = []
    passed = []
    for direction in generator.normal(size=(3000, 3)):
        displaced = POINTS_MM.copy()
        displaced[worst.index] += worst.displaced_mm * direction / np.linalg.norm(direction)
        fit = register(POINTS_MM, displaced, covariance_mm2=COVARIANCE_MM2)
        shift_mm = float(np.linalg.norm(fit.transform.apply(TARGET_MM) - TARGET_MM))
        found.append((shift_mm, displaced))
    shift_mm, displaced = max(found, key=lambda one: one[0])
    assert shift_mm == pytest.approx(worst.at_target_mm, rel=0.02)
    for _ in range(1000):
        error_mm = generator.normal(0.0, SIGMA_MM, (5, 3))
        fit = register(POINTS_MM, displaced + error_mm, covariance_mm2=COVARIANCE_MM2)
        mapped = fit.transform.apply(POINTS_MM)
        found_square = chi_square_of_shared(fit.residuals_mm, mapped, COVARIANCE_MM2, np.zeros((5, 3, 1)))
        passed.append(found_square < LIMIT)
    assert np.mean(passed) == pytest.approx(0.5, abs=0.1)


def test_a_point_that_leaves_no_residual_is_held_by_the_largest_displacement_alone() -> None:
    worst = _worst(POINTS_MM[:3], 2.5)
    assert worst.displaced_mm == pytest.approx(2.5)
    assert worst.at_target_mm > 1.0
