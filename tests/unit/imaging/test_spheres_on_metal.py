"""Spheres on metal in the CT of a second scanner: shadows through them hide none."""

from __future__ import annotations

import numpy as np
import pytest
from fan_beam import Mounted, scan
from localized_spheres import as_volume
from painted_ct import Scan

from procedures.imaging import Volume, localize
from procedures.imaging.errors import MarkerCountWrong

BELOW, ASIDE = (0.0, 1.0, 0.0), (0.6, 0.8, 0.0)
CLEAR_MM = 4.5  # from the centre: inside, whatever the blur
SHADOW_HU = 150.0
MOST_ERROR_MM = 0.04  # with streaks through the ball


def check_found(volume: Volume, *mounted: Mounted, diameter_mm: float = 11.5) -> None:
    """Exactly these balls are markers, each near its place and within its covariance."""
    markers = localize(volume, diameter_mm=diameter_mm).markers
    assert len(markers) == len(mounted)
    for ball in mounted:
        marker = min(markers, key=lambda one: float(np.linalg.norm(np.subtract(one.centre_mm, ball.centre))))
        error = np.subtract(marker.centre_mm, ball.centre)
        assert np.linalg.norm(error) < MOST_ERROR_MM
        assert error @ np.linalg.solve(marker.covariance_mm2, error) < 21.1  # 0.01 % of three degrees


@pytest.mark.parametrize("metal", [pytest.param("titanium", marks=pytest.mark.slow), "steel"])
def test_a_ball_whose_own_screw_shades_it_from_the_side_is_found(metal: str) -> None:
    ball = Mounted((0.3, -6.2, 0.4), ASIDE, metal)
    volume = scan(ball)
    places = volume.geometry.to_patient_mm(np.argwhere(np.ones(volume.voxels.shape, dtype=bool)))
    inside = volume.voxels.ravel()[np.linalg.norm(places - ball.centre, axis=1) < CLEAR_MM]
    assert inside.min() < np.median(inside) - SHADOW_HU
    check_found(volume, ball)


@pytest.mark.slow
def test_twins_on_steel_are_both_found() -> None:
    twins = [Mounted((x, -6.2, 0.4), BELOW, "steel") for x in (-7.3, 6.7)]
    check_found(scan(*twins), *twins)


@pytest.mark.slow
def test_a_small_ball_is_found_beside_a_larger_one_on_the_same_metal() -> None:
    small = Mounted((8.7, -6.2, 0.4), BELOW, "titanium", ball_mm=5.0)
    large = Mounted((-8.3, -6.2, 0.4), BELOW, "titanium")
    check_found(scan(small, large), small, diameter_mm=10.0)


@pytest.mark.parametrize(("on_metal", "odds"), [(True, (0.2, 0.5)), (False, (-0.1, 0.1))])
def test_a_ball_that_shows_too_little_is_doubtful_in_the_slices_of_metal_and_else_rejected(
    on_metal: bool, odds: tuple[float, float]
) -> None:
    ball, canvas = np.array([20.2, 19.7, 20.3]), Scan()
    canvas.half_space(ball - np.array(BELOW), np.array([0.1, -1.0, 0.2]), 150.0)
    canvas.ball(ball)
    if on_metal:
        canvas.rod(ball + np.array([0.0, 4.25, 0.0]), np.array(BELOW), 12.0, 1.6, 3000.0)
    with pytest.raises(MarkerCountWrong) as refused:
        localize(as_volume(canvas))
    (found,) = (one for one in refused.value.candidates if one.radius_mm is not None)
    np.testing.assert_allclose(found.centre_mm, ball, atol=0.1)
    assert "shows only 40% of a sphere's surface" in found.reason
    assert odds[0] < found.odds < odds[1]
