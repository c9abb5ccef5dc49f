"""A noise-aware fit: unbiased, better than weighting all voxels equally, with an honest covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from painted_ct import Scan

from procedures.imaging.examination import combine_estimates
from procedures.imaging.sphere_centre.ball_model import (
    BALL,
    IN,
    OUT,
    RADIUS,
    SLOPE,
    SXY,
    SZ,
    BallVoxels,
    Stretch,
    intensities,
    polynomial,
    products,
    stretch_matrix,
)
from procedures.imaging.sphere_centre.blurred_ball import EDGE, BlurredBall, fit_rough_ball, fit_whitened
from procedures.imaging.sphere_centre.correlated_noise import (
    WINDOW_MM,
    CorrelatedNoise,
    VoxelGrid,
    WhitenedStep,
)
from procedures.imaging.sphere_centre.radial_edge import RadialEdge
from procedures.imaging.sphere_centre.streak_prior import BENT, StreakPrior
from procedures.imaging.volume import Region
from ronna_hw.arrays import Array

Equations = tuple[WhitenedStep, Array, VoxelGrid]
SPACING_MM = np.array([1.0, 0.5, 0.5])
SHAPE = (19, 37, 37)
CENTRE_MM = np.array([9.1, 9.2, 8.9])
RADIUS_MM = 5.75
SIDE = 0.49  # taps beside the middle one, as the phantom's scanner has them
NOISE_HU = 20.0


def edge_of(centre_mm: Array, inside_hu: float) -> RadialEdge:
    nowhere = np.zeros(1, dtype=bool)
    return RadialEdge(
        centre_mm, RADIUS_MM, 1e-4 * np.eye(3), 1.0, 0.0, 0.0, inside_hu, -1000.0, 1.0, 0.0, nowhere
    )


def noise_hu(seed: int) -> Array:
    """Slow noise: white, smoothed within each slice."""
    white = np.random.default_rng(seed).standard_normal((SHAPE[0], SHAPE[1] + 2, SHAPE[2] + 2))
    rows = white[:, 1:-1] + SIDE * (white[:, :-2] + white[:, 2:])
    both = rows[:, :, 1:-1] + SIDE * (rows[:, :, :-2] + rows[:, :, 2:])
    return np.asarray(both * NOISE_HU / (1.0 + 2.0 * SIDE**2))


def true_power(grid: VoxelGrid) -> Array:
    """The spectrum of that noise over the half spectrum of a grid."""
    gains = [
        (1.0 + 2.0 * SIDE * np.cos(2.0 * np.pi * np.fft.fftfreq(count))) ** 2 / (1.0 + 2.0 * SIDE**2)
        for count in grid.padded[1:]
    ]
    plane = NOISE_HU**2 * gains[0][:, None] * gains[1][None, : grid.padded[2] // 2 + 1]
    return np.asarray(np.broadcast_to(plane, (grid.padded[0], *plane.shape)))


def truth(terms: int) -> Array:
    unknowns = np.zeros(terms)
    unknowns[[0, 1, 2, OUT, IN, SZ, SXY, RADIUS]] = [*CENTRE_MM, -1000.0, 130.0, 0.45, 0.45, RADIUS_MM]
    return unknowns


@pytest.fixture(scope="module")
def voxels() -> BallVoxels:
    """Noise-free voxels of a ball."""
    axes = [np.arange(n) * step for n, step in zip(SHAPE, SPACING_MM, strict=True)]
    points_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    usable = np.linalg.norm(points_mm - CENTRE_MM, axis=-1) < RADIUS_MM + 2.25
    region = Region(np.zeros(SHAPE), np.zeros(3, dtype=np.int64), SPACING_MM)
    made = BallVoxels.of(region, usable, RADIUS_MM)
    made.values[:], _ = intensities(made.points_mm, truth(BENT.start + 16), made.background)
    return made


def noisy(voxels: BallVoxels, seed: int) -> BallVoxels:
    values = voxels.values + noise_hu(seed)[tuple(voxels.voxel_index.T)]
    return replace(voxels, values=values)


@pytest.fixture(scope="module")
def equations(voxels: BallVoxels) -> Equations:
    """Those of the ball in noise whose spectrum is known, its derivatives, and the grid."""
    derivatives, *_ = voxels.evaluate(truth(BENT.start + 16))
    grid = VoxelGrid.from_indices(voxels.voxel_index, WINDOW_MM, SPACING_MM)
    power = true_power(grid)
    noise = CorrelatedNoise(grid, np.maximum(power, 0.1 * NOISE_HU**2))
    smooth = np.ones(derivatives.shape[1], dtype=bool)
    smooth[EDGE] = False
    step = WhitenedStep.from_fit(noise, derivatives, grid.spectra(derivatives), 1.0, smooth)
    return step, derivatives, grid


def test_the_centre_estimate_responds_to_the_centre_alone(equations: Equations) -> None:
    step, derivatives, _ = equations
    answered = step.influence.T @ derivatives
    np.testing.assert_allclose(answered[:, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(answered[:, 3:] * 20.0, 0.0, atol=1e-4)  # mm by terms of 20 HU


def test_whitening_beats_weighting_all_voxels_equally(equations: Equations) -> None:
    step, derivatives, grid = equations
    even = np.linalg.pinv(derivatives)[:3].T
    spectra = grid.spectra(even)
    by_even = np.trace(grid.products(spectra, spectra, true_power(grid)))
    spectra = grid.spectra(step.influence)
    by_ours = np.trace(grid.products(spectra, spectra, true_power(grid)))
    assert by_ours < 0.85 * by_even
    assert by_ours <= np.trace(step.covariance[:3, :3])  # which holds a floor of fine noise besides


def test_the_noise_estimate_compensates_for_what_the_fit_absorbed(voxels: BallVoxels) -> None:
    true_slow = (NOISE_HU * (1.0 + 2.0 * SIDE) ** 2 / (1.0 + 2.0 * SIDE**2)) ** 2
    derivatives, *_ = voxels.evaluate(truth(BENT.start + 16))
    grid = VoxelGrid.from_indices(voxels.voxel_index, WINDOW_MM, SPACING_MM)
    orthogonal, _ = np.linalg.qr(derivatives)
    given, kept = [], []
    for seed in range(6):
        values = noise_hu(seed)[tuple(voxels.voxel_index.T)]
        left = values - orthogonal @ (orthogonal.T @ values)
        given.append(CorrelatedNoise.from_fit(grid, left, grid.spectra(derivatives), 0.1).slow_power)
        kept.append(CorrelatedNoise.from_fit(grid, left, grid.spectra(derivatives[:, :1]), 0.1).slow_power)
    assert np.mean(given) == pytest.approx(true_slow, rel=0.15)
    assert np.mean(kept) < 0.93 * np.mean(given)


def test_the_power_of_a_projection_equals_its_dimension(voxels: BallVoxels) -> None:
    derivatives, *_ = voxels.evaluate(truth(BENT.start + 16))
    grid = VoxelGrid.from_indices(voxels.voxel_index, WINDOW_MM, SPACING_MM)
    doubled = np.column_stack([derivatives, derivatives[:, 3]])  # adds nothing new
    power = grid.measure_absorbed_power(grid.spectra(doubled))
    assert float(np.sum(power * grid.share)) == pytest.approx(derivatives.shape[1], rel=1e-6)


def test_values_are_recovered_from_their_spectra(voxels: BallVoxels) -> None:
    grid = VoxelGrid.from_indices(voxels.voxel_index, WINDOW_MM, SPACING_MM)
    columns = np.random.default_rng(1).normal(size=(len(voxels.voxel_index), 3))
    spectra = grid.spectra(columns)
    np.testing.assert_allclose(grid.values(spectra), columns, atol=1e-9)
    np.testing.assert_allclose(grid.products(spectra, spectra), columns.T @ columns, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_the_covariance_matches_the_actual_errors(voxels: BallVoxels) -> None:
    squares = []
    for seed in range(16):
        fitted = fit_whitened(noisy(voxels, seed), truth(BENT.start + 16))
        assert fitted is not None
        error_mm = fitted.unknowns[:3] - CENTRE_MM
        squares.append(float(error_mm @ np.linalg.solve(fitted.covariance_mm2, error_mm)))
    assert 0.5 < np.mean(squares) / 3.0 < 1.6  # 48 degrees of freedom


def test_a_stretch_is_told_from_the_blur_and_its_covariance_matches_the_actual_errors(
    voxels: BallVoxels,
) -> None:
    terms = RADIUS_MM * np.array([3.0, -1.0, 2.0, -1.5, 1.0]) * 1e-3
    offsets = voxels.points_mm - CENTRE_MM
    shrunk = np.eye(3) - stretch_matrix(terms) / RADIUS_MM
    wider = truth(BENT.stop)
    wider[[SZ, SXY]] = 0.6, 0.4  # of another blur than where the fit starts
    stretched, _ = intensities(CENTRE_MM + offsets @ shrunk, wider, voxels.background)
    found, squared = [], []
    for seed in range(12):
        fitted = fit_whitened(noisy(replace(voxels, values=stretched), seed), wider)
        assert fitted is not None
        error = fitted.stretch.coefficients_mm - terms
        squared.append(float(error @ np.linalg.solve(fitted.stretch.covariance_mm2, error)) / 5.0)
        found.append(fitted.stretch.coefficients_mm)
    np.testing.assert_allclose(np.mean(found, axis=0), terms, atol=4e-4 * RADIUS_MM)
    assert 0.4 < np.mean(squared) < 1.8


def test_voxels_that_do_not_belong_to_the_ball_are_excluded_with_their_blur(voxels: BallVoxels) -> None:
    spoiled = noisy(voxels, 3)
    at_post = np.linalg.norm(spoiled.points_mm - CENTRE_MM - np.array([0.0, RADIUS_MM, 0.0]), axis=1)
    spoiled.values[at_post < 1.5] += 900.0
    clear = spoiled.without_outliers(truth(BENT.start + 16))
    left = np.linalg.norm(clear.points_mm - CENTRE_MM - np.array([0.0, RADIUS_MM, 0.0]), axis=1)
    assert left.min() > 1.5 + 0.5
    assert len(voxels.voxel_index) - len(clear.voxel_index) < 1.2 * np.sum(at_post < 1.5 + 1.2)


def test_a_half_covered_ball_is_fitted_better_when_flagged_as_covered(voxels: BallVoxels) -> None:
    """Where its cover ends it leaves traces that noise nearly hides: 60 HU in noise of 20."""
    from_centre_mm = voxels.points_mm - CENTRE_MM
    at_surface = np.abs(np.linalg.norm(from_centre_mm, axis=1) - RADIUS_MM) < 0.8
    at_rim = at_surface & (np.abs(from_centre_mm[:, 1] - 1.5) < 0.8)
    offsets_mm: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(4):
        spoiled = noisy(voxels, seed)
        spoiled.values[at_rim] += 60.0
        for covered, offsets in offsets_mm.items():
            fitted = fit_whitened(replace(spoiled, covered=covered), truth(BENT.start + 16))
            assert fitted is not None
            offsets.append(float(np.linalg.norm(fitted.unknowns[:3] - CENTRE_MM)))
    assert np.mean(offsets_mm[True]) < 0.8 * np.mean(offsets_mm[False])


def test_bends_are_detected_above_the_noise_and_slopes_are_assumed_larger() -> None:
    covariance = np.diag(np.full(16, 4.0))
    none = StreakPrior.from_bends(np.full(16, 1.9), covariance)
    assert (none.bent_hu2, none.streak_hu) == (0.0, 0.0)
    assert none.uncertainty_hu2 == pytest.approx(4.0 * np.sqrt(2.0 / 16.0))
    seen = StreakPrior.from_bends(np.full(16, 10.0), covariance)
    assert seen.bent_hu2 == pytest.approx(100.0 - 4.0)
    sloping = seen.with_slopes(np.zeros(3), np.eye(3))
    assert sloping.slope_hu2 == pytest.approx(4.0 * seen.bent_hu2)
    drawn = sloping.stiffness(BENT.start + 16)
    assert drawn[SLOPE].max() < drawn[BENT].min()
    assert drawn[: SLOPE.start].max() == 0.0


def test_an_estimate_that_adds_no_information_gets_no_weight() -> None:
    round_ = Stretch(np.zeros(5), np.zeros((5, 5)), 0.45)
    ball = BlurredBall(CENTRE_MM, 1e-6 * np.eye(3), RADIUS_MM, 0.0, 0.0, 1100.0, round_, round_)
    combined = combine_estimates(edge_of(CENTRE_MM + 0.02, 130.0), ball, SPACING_MM)
    towards_edge_mm = (combined.centre_mm - CENTRE_MM) @ np.ones(3) / np.sqrt(3.0)
    assert -1e-6 < towards_edge_mm < 1e-4  # nor is the ball's moved away from it
    assert combined.agreement_mm == pytest.approx(0.02 * np.sqrt(3.0))


STREAKED_CENTRE_MM = np.array([14.2, 13.9, 14.1])
STREAKED_SHAPE = (29, 57, 57)


@pytest.fixture(scope="module")
def bare() -> Array:
    """A ball in noise, HU."""
    scan = Scan(shape=STREAKED_SHAPE, spacing_mm=tuple(SPACING_MM), noise_hu=NOISE_HU, seed=4)
    scan.ball(STREAKED_CENTRE_MM)
    return np.asarray(scan.voxels(), dtype=float)


def fitted(values: Array) -> BlurredBall:
    region = Region(values, np.zeros(3, dtype=np.int64), SPACING_MM)
    rough = fit_rough_ball(region, edge_of(STREAKED_CENTRE_MM + 0.1, 150.0))
    assert rough is not None
    ball = rough.refined(np.zeros((0, 3)))
    assert ball is not None
    return ball


def offsets() -> Array:
    """(slices, rows, columns, 3) in radii from the centre."""
    index = np.stack(np.meshgrid(*(np.arange(n) for n in STREAKED_SHAPE), indexing="ij"), axis=-1)
    return (index * SPACING_MM - STREAKED_CENTRE_MM) / RADIUS_MM


def error_mm(ball: BlurredBall) -> float:
    return float(np.linalg.norm(ball.centre_mm - STREAKED_CENTRE_MM))


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
    points_mm = STREAKED_CENTRE_MM + random.uniform(-8.0, 8.0, (50, 3))
    background = polynomial((points_mm - STREAKED_CENTRE_MM) / RADIUS_MM, (1, 2, 3))
    bends = random.normal(0.0, 20.0, background.shape[1])
    unknowns = np.concatenate([STREAKED_CENTRE_MM, [-1000.0, 150.0, 0.45, 0.45, RADIUS_MM], bends])
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
