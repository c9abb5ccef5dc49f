"""Spheres are located to a few micrometres, with an honest covariance."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from localized_spheres import as_volume, matched, rms
from painted_ct import Scan

from procedures.imaging import Volume, errors, localize, localize_picks, read_series
from ronna_hw.arrays import Array

GOOD = {"spacing_mm": (1.0, 0.5, 0.5), "noise_hu": 20.0, "shape": (40, 80, 160)}
POOR = {"spacing_mm": (2.0, 0.7, 0.7), "noise_hu": 50.0, "shape": (20, 58, 114)}
CONTRAST_HU, RADIUS_MM, BLUR_MM = 1150.0, 5.75, 0.42


def pairs_of_markers(protocol: dict[str, Any], kind: str, scans: int) -> tuple[Array, Array]:
    """Errors and covariances of two markers at random places in each of several scans."""
    errors_mm, covariances = [], []
    for seed in range(scans):
        random = np.random.default_rng(seed)
        scan = Scan(seed=seed, **protocol)
        centres = np.array([[20.0, 20.0, 20.0], [20.0, 20.0, 60.0]]) + random.uniform(-1.0, 1.0, (2, 3))
        for centre in centres:
            direction = random.standard_normal(3)
            if kind == "clean":
                scan.ball(centre)
            else:
                scan.marker(centre, direction, skin=False)
            if kind == "streaks":
                metal = centre + 9.75 * direction / np.linalg.norm(direction)
                scan.streaks(metal, phase_rad=random.uniform(0.0, 2.0 * np.pi))
        error, covariance = matched(localize(as_volume(scan), expected=2), centres)
        errors_mm.append(error)
        covariances.append(covariance)
    return np.concatenate(errors_mm), np.concatenate(covariances)


@pytest.mark.parametrize(
    ("protocol", "kind", "limit_mm"),
    [
        (GOOD, "post", 0.010),
        pytest.param(POOR, "post", 0.025, marks=pytest.mark.slow),
        pytest.param(GOOD, "streaks", 0.035, marks=pytest.mark.slow),
        (POOR, "streaks", 0.050),
    ],
    ids=["good", "poor", "good with streaks", "poor with streaks"],
)
@pytest.mark.parametrize("scans", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_markers_on_posts_are_located_accurately_and_the_covariance_is_honest(
    protocol: dict[str, Any], kind: str, limit_mm: float, scans: int
) -> None:
    error, covariance = pairs_of_markers(protocol, kind, scans)
    assert rms(error) <= limit_mm
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert 0.4 <= squared.mean() / 3.0 <= 2.5
    assert np.linalg.eigvalsh(covariance).min() > 0.0


@pytest.mark.parametrize("scans", [3, pytest.param(5, marks=pytest.mark.slow)])
def test_plain_balls_come_close_to_the_cramer_rao_bound(scans: int) -> None:
    error, _ = pairs_of_markers(GOOD, "clean", scans)
    voxel_mm3 = float(np.prod(GOOD["spacing_mm"]))
    information = voxel_mm3 * 2.0 * np.sqrt(np.pi) * BLUR_MM * 3.0 / (4.0 * np.pi * RADIUS_MM**2)
    bound_mm = np.sqrt(3.0) * GOOD["noise_hu"] / CONTRAST_HU * np.sqrt(information)
    assert rms(error) <= 2.5 * bound_mm  # the noise is correlated: the bound for white noise is out of reach


def test_a_ball_at_a_voxel_centre_is_located_without_a_half_voxel_offset(
    dicom_series: Callable[..., Path],
) -> None:
    scan = Scan(spacing_mm=(1.25, 0.7, 0.5), shape=(32, 58, 80))
    scan.ball(np.array([16 * 1.25, 29 * 0.7, 40 * 0.5]))  # the centre of voxel (16, 29, 40)
    folder = dicom_series(scan.voxels(), scan.spacing_mm, origin_mm=(100.0, -50.0, 25.0))
    marker = localize(read_series(folder)).markers[0]
    expected = [100 + 40 * 0.5, -50 + 29 * 0.7, 25 + 16 * 1.25]
    np.testing.assert_allclose(marker.centre_mm, expected, atol=0.02)


def test_an_oblique_or_reversed_series_gives_the_same_patient_points(
    dicom_series: Callable[..., Path],
) -> None:
    scan = Scan(shape=(40, 80, 120))
    centres = np.array([[17.3, 21.2, 18.4], [22.1, 17.9, 41.3]])
    for centre in centres:
        scan.marker(centre, np.array([0.2, 1.0, 0.3]), skin=False)
    voxels = scan.voxels()
    row = np.array([0.8, 0.6, 0.0])
    column = np.array([-0.36, 0.48, -0.8])
    normal = np.cross(row, column)
    origin = np.array([12.0, -34.0, 56.0])
    expected = origin + centres @ np.array([normal, column, row])
    options = {"row_direction": tuple(row), "column_direction": tuple(column), "origin_mm": tuple(origin)}
    straight = localize(read_series(dicom_series(voxels, **options)), expected=2)
    error, covariance = matched(straight, expected)
    assert rms(error) < 0.015
    squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    assert squared.max() < 30.0  # the covariance is turned with the axes
    again = read_series(dicom_series(voxels, name="reversed", reverse=True, **options))
    reversed_order = localize(again, expected=2)
    np.testing.assert_array_equal(straight.centres_mm, reversed_order.centres_mm)


def test_markers_are_ordered_from_superior_to_inferior_and_repeat_bit_for_bit() -> None:
    scan = Scan(shape=(60, 80, 100))
    scan.ball(np.array([14.0, 20.0, 14.0]))
    scan.ball(np.array([44.0, 20.0, 34.0]))
    volume = as_volume(scan)
    first, second = localize(volume), localize(volume)
    # the axes of this volume are (slice, row, column) = (L, P, S)
    assert [round(float(marker.centre_mm[2])) for marker in first.markers] == [34, 14]
    np.testing.assert_array_equal(first.centres_mm, second.centres_mm)
    np.testing.assert_array_equal(first.covariances_mm2, second.covariances_mm2)


def test_a_cylinder_a_large_ball_and_a_metal_ball_are_rejected_with_reasons() -> None:
    scan = Scan(shape=(56, 100, 200))
    scan.rod(np.array([2.0, 12.0, 12.0]), np.array([1.0, 0.1, 0.1]), 52.0, 6.0, 150.0)
    scan.ball(np.array([28.0, 25.0, 40.0]), radius_mm=8.0)
    scan.ball(np.array([28.0, 25.0, 64.0]), hu=2500.0)
    scan.marker(np.array([28.0, 25.0, 85.0]), np.array([0.0, 1.0, 0.0]), skin=False)
    result = localize(as_volume(scan), expected=1)
    np.testing.assert_allclose(result.markers[0].centre_mm, [28.0, 25.0, 85.0], atol=0.02)
    reasons = " ".join(candidate.reason for candidate in result.candidates if not candidate.accepted)
    assert "of a sphere's surface" in reasons
    assert "has radius 7.8" in reasons
    assert "no surface of a polymer sphere" in reasons


def test_a_marker_over_skin_is_localized() -> None:
    scan = Scan(shape=(40, 100, 80))
    centre = np.array([20.3, 15.6, 20.1])
    scan.marker(centre, np.array([0.3, 1.0, -0.2]))
    error, _ = matched(localize(as_volume(scan)), centre[None, :])
    assert rms(error) < 0.02


@pytest.mark.parametrize(("depth_mm", "accepted"), [(3.0, True), (-3.0, False)])
def test_a_ball_cut_off_by_the_scan_field_is_flagged_or_rejected(depth_mm: float, accepted: bool) -> None:
    scan = Scan(shape=(40, 80, 80))
    scan.ball(np.array([20.0, depth_mm, 20.0]))
    if accepted:
        marker = localize(as_volume(scan), expected=1).markers[0]
        assert "cut_by_field" in marker.flags
        assert marker.quality < 0.8
    else:
        with pytest.raises(errors.MarkerCountWrong) as caught:
            localize(as_volume(scan), expected=1)
        assert all(not candidate.accepted for candidate in caught.value.candidates)


def test_a_whole_ball_near_the_edge_of_the_field_is_not_flagged_as_cut() -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.0, 7.0, 20.0])
    scan.ball(centre)
    marker = localize(as_volume(scan), expected=1).markers[0]
    assert "cut_by_field" not in marker.flags
    np.testing.assert_allclose(marker.centre_mm, centre, atol=0.02)


def test_padding_outside_the_round_field_counts_as_not_scanned() -> None:
    scan = Scan(shape=(40, 80, 80))
    scan.ball(np.array([20.0, 14.0, 20.0]))
    volume = as_volume(scan)
    padded = volume.voxels.copy()
    padded[:, :20, :] = -3024  # four millimetres of the ball are missing
    cut = Volume(padded, volume.geometry, "1.2.3", "1.2.4")
    marker = localize(cut, expected=1).markers[0]
    assert "cut_by_field" in marker.flags
    np.testing.assert_allclose(marker.centre_mm, [20.0, 14.0, 20.0], atol=0.05)


@pytest.mark.branch("CT_DISAGREEMENT")
def test_a_misshapen_ball_is_flagged_and_gets_a_larger_uncertainty() -> None:
    scan = Scan(shape=(40, 80, 80))
    centre = np.array([20.0, 20.0, 20.0])
    scan.ball(centre)
    scan.ball(centre + np.array([0.0, 1.0, 0.0]), radius_mm=5.4)  # a lump on one side
    (marker,) = localize_picks(as_volume(scan), centre[None, :]).markers
    assert "estimators_disagree" in marker.flags
    assert marker.agreement_mm > 0.06
    assert marker.quality < 0.5
    error_mm = float(np.linalg.norm(marker.centre_mm - centre))
    assert error_mm < 3.0 * marker.sigma_mm


def test_a_dent_and_a_bubble_do_not_pull_the_centre() -> None:
    scan = Scan(shape=(40, 80, 120))
    dented, hollow = np.array([20.0, 20.0, 18.0]), np.array([20.0, 20.0, 42.0])
    scan.ball(dented)
    scan.rod(dented + np.array([0.0, 3.9, 0.0]), np.array([0.0, 1.0, 0.0]), 4.0, 4.4, -1000.0)
    scan.ball(hollow)
    scan.ball(hollow + np.array([0.0, -2.0, 2.0]), radius_mm=2.0, hu=-1000.0)
    volume, centres = as_volume(scan), np.array([dented, hollow])
    error, _ = matched(localize_picks(volume, centres), centres)
    assert np.abs(error).max() < 0.03


def test_another_diameter_can_be_requested() -> None:
    scan = Scan(shape=(40, 80, 80))
    scan.ball(np.array([20.3, 19.6, 20.2]), radius_mm=4.0)
    with pytest.raises(errors.MarkerCountWrong):
        localize(as_volume(scan))
    marker = localize(as_volume(scan), diameter_mm=8.0).markers[0]
    np.testing.assert_allclose(marker.centre_mm, [20.3, 19.6, 20.2], atol=0.02)
    assert marker.radius_mm == pytest.approx(4.0, abs=0.05)


def test_a_wrong_marker_count_is_refused_with_all_candidates() -> None:
    scan = Scan()
    scan.ball(np.array([20.0, 20.0, 20.0]))
    with pytest.raises(errors.MarkerCountWrong, match="1 marker found, 3 expected") as caught:
        localize(as_volume(scan), expected=3)
    assert caught.value.exit_code == 3
    (candidate,) = caught.value.candidates
    assert candidate.accepted
    np.testing.assert_allclose(candidate.centre_mm, [20.0, 20.0, 20.0], atol=0.02)
    assert "(20.0, 20.0, 20.0) is a marker" in str(caught.value)


def test_an_empty_scan_is_refused_unless_nothing_is_expected() -> None:
    volume = as_volume(Scan())
    with pytest.raises(errors.MarkerCountWrong, match="no marker found"):
        localize(volume)
    assert localize(volume, expected=0).centres_mm.shape == (0, 3)


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({"diameter_mm": 1.0}, "CT-017"),
        ({"diameter_mm": float("nan")}, "^(?!.*at most nan)"),
        ({"diameter_mm": 0.0115}, r"got 0\.0115 mm\. Are these metres"),
        ({"diameter_mm": 30.0}, "do not fit"),
        ({"expected": -1}, "CT-017"),
        ({"expected": "3"}, "CT-017"),
    ],
)
def test_impossible_requests_are_refused(request_: dict[str, Any], said: str) -> None:
    with raises(errors.LOCALIZATION_MISUSED, match=said):
        localize(as_volume(Scan(shape=(20, 40, 40))), **request_)


def test_progress_runs_from_zero_to_one() -> None:
    scan = Scan()
    scan.ball(np.array([20.0, 20.0, 20.0]))
    shares: list[float] = []
    localize(as_volume(scan), progress=shares.append)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)


def test_the_expected_number_of_clear_markers_is_taken_and_the_least_likely_told() -> None:
    scan = Scan(seed=1, **GOOD)
    for centre_mm in ((20, 20, 15), (20, 20, 35), (22, 18, 55)):
        scan.ball(centre_mm)
    scan.ball((20, 21, 70), radius_mm=5.9)
    assert len(localize(as_volume(scan)).markers) == 4
    result = localize(as_volume(scan), expected=3)
    assert len(result.markers) == 3
    (doubtful,) = result.doubtful
    assert "is less marker-like than the expected number of others" in doubtful.describe()
