"""A background bent by streaks does not pull the centre, and the remaining uncertainty is stated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.imaging.region import Region
from procedures.imaging.sphere_centre.ball_model import BALL, SXY, SZ, intensities, polynomial, products
from procedures.imaging.sphere_centre.blurred_ball import BlurredBall, fit_rough_ball

Array = NDArray[np.float64]

CENTRE_MM = np.array([14.2, 13.9, 14.1])
SPACING_MM = np.array([1.0, 0.5, 0.5])
SHAPE = (29, 57, 57)
RADIUS_MM = 5.75
NOISE_HU = 20.0


@pytest.fixture(scope="module")
def bare(make_scan: Callable[..., Any]) -> Array:
    """A ball in noise, HU."""
    scan = make_scan(shape=SHAPE, spacing_mm=tuple(SPACING_MM), noise_hu=NOISE_HU, seed=4)
    scan.ball(CENTRE_MM)
    return np.asarray(scan.voxels(), dtype=float)


def fitted(values: Array) -> BlurredBall:
    rough = fit_rough_ball(
        Region(values, np.zeros(3, dtype=np.int64), SPACING_MM), CENTRE_MM + 0.1, RADIUS_MM, 150.0, -1000.0
    )
    assert rough is not None
    ball = rough.refined(np.zeros((0, 3)))
    assert ball is not None
    return ball


def offsets() -> Array:
    """(slices, rows, columns, 3) in radii from the centre."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij"), axis=-1)
    return (index * SPACING_MM - CENTRE_MM) / RADIUS_MM


def error_mm(ball: BlurredBall) -> float:
    return float(np.linalg.norm(ball.centre_mm - CENTRE_MM))


def sigma_mm(ball: BlurredBall) -> float:
    return float(np.sqrt(np.trace(ball.covariance_mm2)))


def test_a_ball_without_streaks_shows_no_bend_and_has_the_covariance_of_noise(bare: Array) -> None:
    ball = fitted(bare)
    assert ball.streak_hu < 3.0
    assert error_mm(ball) < 3.0 * sigma_mm(ball) < 0.02


def test_a_third_degree_bend_is_detected_and_hardly_moves_the_centre(bare: Array) -> None:
    _, y, x = np.moveaxis(offsets(), -1, 0)
    bend_hu = 60.0 * (x**3 - 2.0 * x * y**2 + y**3)
    ball, plain = fitted(bare + bend_hu), fitted(bare)
    assert np.linalg.norm(ball.centre_mm - plain.centre_mm) < 0.004
    assert 10.0 < ball.streak_hu < 100.0
    assert sigma_mm(ball) > sigma_mm(plain)


def test_a_background_beyond_the_polynomials_is_covered_by_the_covariance(bare: Array) -> None:
    z, y, x = np.moveaxis(offsets(), -1, 0)
    lobes = np.sin(4.0 * np.arctan2(y + 1.6, x)) * 2.0 / np.maximum(np.hypot(x, y + 1.6) * RADIUS_MM, 2.0)
    ball = fitted(bare + 250.0 * lobes * np.exp(-2.0 * z**2))
    assert error_mm(ball) < 3.0 * sigma_mm(ball)
    assert sigma_mm(ball) < 0.06


def test_the_derivatives_of_the_model_are_correct_for_an_isotropic_blur() -> None:
    random = np.random.default_rng(2)
    points_mm = CENTRE_MM + random.uniform(-8.0, 8.0, (50, 3))
    background = polynomial((points_mm - CENTRE_MM) / RADIUS_MM, (1, 2, 3))
    bends = random.normal(0.0, 20.0, background.shape[1])
    unknowns = np.concatenate([CENTRE_MM, [-1000.0, 150.0, 0.45, 0.45, RADIUS_MM], bends])
    _, derivatives = intensities(points_mm, unknowns, background)
    assert derivatives.shape == (50, BALL + 19)
    for number in set(range(len(unknowns))) - {SZ, SXY}:
        step = np.zeros(len(unknowns))
        step[number] = 1e-5
        after, _ = intensities(points_mm, unknowns + step, background)
        before, _ = intensities(points_mm, unknowns - step, background)
        np.testing.assert_allclose(derivatives[:, number], (after - before) / 2e-5, rtol=1e-4, atol=1e-2)


def test_blockwise_products_equal_the_matrix_product() -> None:
    random = np.random.default_rng(3)
    one, other = random.normal(size=(1300, 4)), random.normal(size=(1300, 7))
    np.testing.assert_allclose(products(one, other), one.T @ other, rtol=1e-12)
