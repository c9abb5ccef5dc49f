"""The chi-square of residuals whose points share errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from procedures.registration import register
from procedures.registration.shared_residual import chi_square_of_shared

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
