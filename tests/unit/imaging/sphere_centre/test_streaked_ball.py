"""A ball under streaks: its centre is not pulled, its covariance is honest, other shapes are rejected."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.imaging.sphere_centre.ball_model import IN, OUT, RADIUS, SXY, SZ, intensities
from procedures.imaging.sphere_centre.radial_edge import RadialEdge, ray_directions
from procedures.imaging.sphere_centre.streaked_ball import StreakedBall, fit_streaked_ball
from procedures.imaging.volume import AIR_HU, Region
from ronna_hw.arrays import Array

SPACING_MM = np.array([1.0, 0.5, 0.5])
SHAPE = (25, 49, 49)
CENTRE_MM = np.array([12.1, 12.2, 11.9])
RADIUS_MM, INSIDE_HU, NOISE_HU, LOWEST_HU = 5.75, 150.0, 20.0, -1024.0


def ball_hu(squeezed: float = 1.0) -> Array:
    """A blurred ball in air, without noise, its half-axis across the slices that much shorter."""
    axes = [np.arange(count) * step for count, step in zip(SHAPE, SPACING_MM, strict=True)]
    points_mm = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points_mm[:, 0] = CENTRE_MM[0] + (points_mm[:, 0] - CENTRE_MM[0]) / squeezed
    unknowns = np.zeros(8)
    unknowns[[0, 1, 2, OUT, IN, SZ, SXY, RADIUS]] = [*CENTRE_MM, AIR_HU, INSIDE_HU, 0.45, 0.45, RADIUS_MM]
    values, _ = intensities(points_mm, unknowns, np.zeros((len(points_mm), 0)))
    return values.reshape(SHAPE)


def streaked(seed: int, band_hu: float, squeezed: float = 1.0) -> Region:
    """The ball, each slice with a band of its own across it, stopped at the scanner's lowest value."""
    random = np.random.default_rng(seed)
    values = ball_hu(squeezed) + NOISE_HU * random.standard_normal(SHAPE)
    along = np.arange(SHAPE[1])[:, None] * SPACING_MM[1] - CENTRE_MM[1]
    across = np.arange(SHAPE[2])[None, :] * SPACING_MM[2] - CENTRE_MM[2]
    for number in range(8, 17):
        turn, off_mm = random.uniform(0.0, np.pi), random.uniform(-4.0, 4.0)
        away_mm = along * np.cos(turn) + across * np.sin(turn) - off_mm
        values[number] += band_hu * random.standard_normal() * np.exp(-0.5 * (away_mm / 2.0) ** 2)
    return Region(np.clip(values, LOWEST_HU, 3071.0), np.zeros(3, dtype=np.int64), SPACING_MM)


def edge_near(offset_mm: Array) -> RadialEdge:
    """What rays found: the sphere, a little beside its place."""
    return RadialEdge(
        centre_mm=CENTRE_MM + offset_mm,
        radius_mm=RADIUS_MM,
        covariance_mm2=0.02**2 * np.eye(3),
        surface_share=1.0,
        unscanned_share=0.0,
        cut_share=0.0,
        inside_hu=INSIDE_HU,
        outside_hu=AIR_HU,
        coherence=1.0,
        covered_step_hu=0.0,
        seen=np.ones(len(ray_directions()), dtype=bool),
    )


def fitted(region: Region, offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> StreakedBall:
    found = fit_streaked_ball(region, edge_near(np.array(offset_mm)))
    assert found is not None
    return found


@pytest.mark.slow
def test_streak_bands_do_not_pull_the_centre_and_the_covariance_is_honest() -> None:
    chi2 = []
    for seed in range(12):
        found = fitted(streaked(seed, 250.0))
        error_mm = found.centre_mm - CENTRE_MM
        assert np.linalg.norm(error_mm) < 0.06
        chi2.append(error_mm @ np.linalg.solve(found.covariance_mm2, error_mm) / 3.0)
    assert 0.3 < np.mean(chi2) < 1.4


def test_clipping_at_the_lowest_scanner_value_does_not_pull_the_centre() -> None:
    values = ball_hu() + NOISE_HU * np.random.default_rng(3).standard_normal(SHAPE)
    values[:, :, : SHAPE[2] // 2] -= 300.0  # dark on one side: in air it is cut off
    region = Region(np.clip(values, LOWEST_HU, 3071.0), np.zeros(3, dtype=np.int64), SPACING_MM)
    assert np.linalg.norm(fitted(region).centre_mm - CENTRE_MM) < 0.06


def test_the_starting_point_makes_no_difference() -> None:
    region = streaked(5, 250.0)
    np.testing.assert_allclose(
        fitted(region).centre_mm, fitted(region, (0.1, -0.15, 0.1)).centre_mm, atol=0.005
    )


def test_cleaning_a_region_more_than_halves_the_streak_variation() -> None:
    region = streaked(7, 300.0)
    near = fitted(region).cleaned
    axes = np.meshgrid(
        *[np.arange(n) * step for n, step in zip(SHAPE, SPACING_MM, strict=True)], indexing="ij"
    )
    inside = np.linalg.norm(np.stack(axes, axis=-1) - CENTRE_MM, axis=-1) < RADIUS_MM - 1.5
    before, after = (np.std(one.values[inside] - INSIDE_HU) for one in (region, near))
    assert after < 0.5 * before


def test_streaks_neither_make_a_ball_look_stretched_nor_hide_that_it_is() -> None:
    region = streaked(7, 300.0)
    assert fitted(region).stretch.difference_mm < 0.08
    longer = fitted(streaked(7, 300.0, squeezed=0.95))
    assert longer.stretch.difference_mm == pytest.approx(0.05 * RADIUS_MM, rel=0.3)
    assert longer.stretch.difference_mm > 8.0 * longer.stretch.deviation_mm


@pytest.mark.parametrize("hollow_mm", [2.8, 4.5, 6.5], ids=["hollow ball", "shell", "nothing at all"])
def test_a_hollow_ball_is_not_fitted_as_a_streaked_one(hollow_mm: float) -> None:
    values = ball_hu() + NOISE_HU * np.random.default_rng(4).standard_normal(SHAPE)
    axes = np.meshgrid(
        *[np.arange(n) * step for n, step in zip(SHAPE, SPACING_MM, strict=True)], indexing="ij"
    )
    values[np.linalg.norm(np.stack(axes, axis=-1) - CENTRE_MM, axis=-1) < hollow_mm] = AIR_HU
    region = Region(values, np.zeros(3, dtype=np.int64), SPACING_MM)
    assert fit_streaked_ball(region, edge_near(np.zeros(3))) is None


@pytest.mark.parametrize("way", np.eye(3).tolist())
def test_a_ball_far_from_where_the_rays_found_it_is_rejected(way: list[float]) -> None:
    assert fit_streaked_ball(streaked(1, 150.0), edge_near(1.2 * np.array(way))) is None
