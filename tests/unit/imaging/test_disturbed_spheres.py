"""A covered, touching or streaked sphere is found in its place; look-alikes are rejected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fan_beam import Mounted, scan
from localized_spheres import as_volume, matched, rms
from painted_ct import Scan

from procedures.imaging import Volume, errors, localize
from procedures.imaging.errors import MarkerCountWrong
from ronna_hw.arrays import Array

RADIUS_MM = 5.75


@pytest.mark.parametrize(
    ("covering_hu", "open_mm"), [(40.0, 0.5), (-50.0, 0.5), (-50.0, -0.3), (-50.0, -1.0)]
)
def test_a_ball_half_covered_by_skin_or_bandage_is_found_and_flagged(
    covering_hu: float, open_mm: float
) -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.3, 19.6, 20.1])
    scan.half_space(centre + np.array([0.0, open_mm, 0.0]), np.array([0.1, -1.0, 0.2]), covering_hu)
    scan.ball(centre)
    marker = localize(as_volume(scan), expected=1).markers[0]
    assert np.linalg.norm(marker.centre_mm - centre) < 0.03
    assert "surface_hidden" in marker.flags
    assert marker.quality < 0.6


def test_the_round_end_of_a_rod_is_not_taken_for_a_half_covered_ball() -> None:
    scan = Scan(shape=(40, 100, 80))
    centre = np.array([20.0, 18.0, 20.0])
    scan.ball(centre)
    scan.rod(centre, np.array([0.0, 1.0, 0.0]), 28.0, RADIUS_MM, 150.0)
    with pytest.raises(errors.MarkerCountWrong, match="no marker found"):
        localize(as_volume(scan))


def test_a_ball_touching_metal_is_flagged_and_still_accurately_located() -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.2, 19.7, 20.3])
    scan.rod(centre + np.array([0.0, RADIUS_MM, 0.0]), np.array([0.0, 1.0, 0.0]), 4.0, 9.0, 3000.0)
    scan.ball(centre)
    marker = localize(as_volume(scan), expected=1).markers[0]
    assert "near_metal" in marker.flags
    assert np.linalg.norm(marker.centre_mm - centre) < 0.05


def test_two_touching_balls_are_separated_and_flagged() -> None:
    scan = Scan(shape=(40, 80, 100))
    centres = np.array([[20.2, 19.7, 19.4], [20.2, 19.7, 31.0]])
    for centre in centres:
        scan.ball(centre)
    result = localize(as_volume(scan), expected=2)
    error, _ = matched(result, centres)
    assert rms(error) < 0.03
    assert all("near_another" in marker.flags for marker in result.markers)


def test_overlapping_balls_are_rejected() -> None:
    scan = Scan(shape=(40, 80, 100))
    scan.ball(np.array([20.0, 19.7, 22.0]))
    scan.ball(np.array([20.0, 19.7, 30.0]))
    with pytest.raises(errors.MarkerCountWrong, match="overlaps a marker"):
        localize(as_volume(scan))


def with_band(scan: Any, centre: Array, hu: float, *angles_deg: float) -> Volume:
    """The scan with bands of streaks across a ball; what would be below the scanner's range stays there."""
    clean = as_volume(scan)
    z, y, x = (np.arange(count) * step for count, step in zip(scan.shape, scan.spacing_mm, strict=True))
    along = np.exp(-0.5 * ((z - centre[0] - 1.0) / 2.0) ** 2)
    voxels = clean.voxels.astype(float)
    for angle in np.radians(angles_deg or (0.0,)):
        across = np.cos(angle) * (y[:, None] - centre[1] - 1.0) - np.sin(angle) * (x[None, :] - centre[2])
        voxels += hu * along[:, None, None] * np.exp(-0.5 * (across / 2.2) ** 2)[None]
    voxels = np.clip(voxels, -1024, 3071).astype(np.int16)
    return Volume(voxels, clean.geometry, "1.2.3", "1.2.4")


@pytest.mark.parametrize("hu", [350.0, -350.0], ids=["bright", "dark, cut off in air"])
def test_a_streak_band_across_a_ball_does_not_pull_its_centre(hu: float) -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.3, 19.6, 20.2])
    scan.marker(centre, np.array([0.0, 1.0, 0.0]), skin=False)
    (marker,) = localize(with_band(scan, centre, hu)).markers
    error = marker.centre_mm - centre
    assert np.linalg.norm(error) < 0.03
    assert error @ np.linalg.solve(marker.covariance_mm2, error) < 16.0  # 99.9 % of an honest covariance
    assert "streaked" in marker.flags


@pytest.mark.parametrize("hu", [350.0, -350.0], ids=["bright", "dark, cut off in air"])
def test_streaks_that_together_shift_a_ball_out_of_a_polymers_range_do_not_hide_it(hu: float) -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.3, 19.6, 20.2])
    scan.marker(centre, np.array([0.0, 1.0, 0.0]), skin=False)
    (marker,) = localize(with_band(scan, centre, hu, 20.0, 80.0, 140.0)).markers
    assert np.linalg.norm(marker.centre_mm - centre) < 0.05
    assert "streaked" in marker.flags


def test_a_ball_that_is_denser_than_a_polymer_without_streaks_is_no_marker() -> None:
    scan = Scan(shape=(40, 80, 80))
    scan.ball(np.array([20.3, 19.6, 20.2]), hu=750.0)
    with pytest.raises(errors.MarkerCountWrong, match="shows no surface of a polymer sphere"):
        localize(as_volume(scan))


def test_a_streak_band_does_not_turn_the_round_end_of_a_rod_into_a_marker() -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.3, 16.0, 20.2])
    scan.ball(centre)
    scan.rod(centre, np.array([0.0, 1.0, 0.0]), 14.0, RADIUS_MM, 150.0)
    with pytest.raises(errors.MarkerCountWrong):
        localize(with_band(scan, centre, 350.0))


@pytest.mark.parametrize("way", [[1.0, 0.0, 0.0], [0.0, 0.3, 1.0], [0.6, 0.6, 0.5]], ids=str)
@pytest.mark.parametrize("longer_mm", [0.7, pytest.param(1.2, marks=pytest.mark.slow)])
def test_a_lone_capsule_a_little_longer_than_wide_is_doubtful(way: list[float], longer_mm: float) -> None:
    scan = Scan(shape=(40, 80, 80))
    for step_mm in np.linspace(-0.5, 0.5, 5) * longer_mm:
        scan.ball(np.array([20.3, 19.6, 20.2]) + step_mm * np.array(way) / np.linalg.norm(way))
    with pytest.raises(errors.MarkerCountWrong, match="longer in one direction than in another") as raised:
        localize(as_volume(scan))
    assert max(one.odds for one in raised.value.candidates) < 0.2


BALL = ((0, 0, 0),)
# balls: offset mm, then radius and HU if they differ from a marker's
LOOK_ALIKES = {
    "knob": ([BALL], "extends beyond a sphere"),
    "capsule": (
        [((0, 0, step_mm),) for step_mm in (-0.6, 0.0, 0.6)],
        "longer in one direction than in another",
    ),
    "cap": ([BALL], "is off a sphere"),
    "hollow ball": ([BALL, ((0, 0, 0), 2.8, -1000.0)], "of its core is a different material"),
    "ball with a bubble": ([BALL, ((0.5, 1.2, 0.6), 2.4, -1000.0)], "of its core is a different material"),
    "ball with metal core": ([BALL, ((0, 0, 0), 1.5, 3000.0)], "has metal in its core"),
    "beads": ([((0, 0, step_mm),) for step_mm in (-11.5, 0.0, 11.5)], "is one of a row"),
}


@pytest.mark.parametrize("look_alike", LOOK_ALIKES)
def test_a_look_alike_of_a_sphere_is_reported_as_doubtful_with_its_reason_and_low_odds(
    look_alike: str,
) -> None:
    scan, at = Scan(shape=(40, 100, 170)), np.array([20.0, 16.0, 22.0])
    balls, reason = LOOK_ALIKES[look_alike]
    for offset_mm, *different in balls:
        scan.ball(at + offset_mm, *different)
    if look_alike == "knob":
        scan.rod(at, np.array([0.2, 1.0, 0.4]), 20.0, 4.0, 150.0)
    if look_alike == "cap":
        scan.half_space(at + np.array([0.0, 3.2, 0.0]), np.array([0.0, -1.0, 0.0]), -1000.0)
    centre = np.array([20.2, 22.1, 70.3])
    scan.marker(centre, np.array([0.0, 1.0, 0.0]), skin=False)
    found = localize(as_volume(scan), expected=1)
    np.testing.assert_allclose(found.centres_mm, centre[None, :], atol=0.02)
    assert found.doubtful
    assert all(one.odds < 0.2 and reason in one.reason for one in found.doubtful)
    assert next(one.odds for one in found.candidates if one.accepted) > 0.9


def test_a_ball_unlike_the_others_in_the_scan_is_doubtful() -> None:
    scan = Scan(shape=(40, 80, 200))
    for place in (15.0, 40.0, 65.0):
        scan.ball(np.array([20.0, 20.0, place]))
    scan.ball(np.array([20.0, 20.0, 88.0]), 6.05)
    found = localize(as_volume(scan))
    assert len(found.markers) == 3
    assert "has radius 6.05 mm, the others 5.75" in found.doubtful[0].reason


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
