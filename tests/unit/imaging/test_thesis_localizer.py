"""The thesis pipeline finds spheres as the thesis reports: to one or two tenths of a millimetre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from localized_spheres import as_volume
from painted_ct import Scan

from procedures.imaging import ThesisFit, Volume, errors, localize_as_thesis, read_series
from procedures.imaging.thesis_localizer import Circles, Cluster, cluster_circles, fit_lines, fit_sphere
from sim.phantom.case import write_case
from sim.world.scene.named_scenes import draw_scene

CENTRES = np.array([[30.2, 19.7, 17.4], [31.1, 20.3, 50.6]])


@pytest.fixture(scope="module")
def volume() -> Volume:
    """Two markers, a cylinder as thick as they, and a larger ball."""
    scan = Scan(shape=(60, 80, 200))
    for centre in CENTRES:
        scan.marker(centre, np.array([0.3, 1.0, 0.2]), skin=False)
    scan.rod(np.array([15.0, 20.0, 73.0]), np.array([1.0, 0.0, 0.0]), 40.0, 6.0, 150.0)
    scan.ball(np.array([30.0, 20.0, 90.0]), radius_mm=8.0)
    return as_volume(scan)


@pytest.mark.parametrize("fit", ThesisFit)
def test_both_fits_find_the_markers_and_nothing_else(volume: Volume, fit: ThesisFit) -> None:
    result = localize_as_thesis(volume, fit, expected=2)
    distance = np.linalg.norm(result.centres_mm[:, None] - CENTRES[None], axis=2)
    assert distance.min(axis=0).max() < 0.3
    assert all("covariance_assumed" in marker.flags for marker in result.markers)
    np.testing.assert_array_equal(localize_as_thesis(volume, fit).centres_mm, result.centres_mm)


def test_the_third_of_exactly_three_spheres_is_not_lost(tmp_path: Path) -> None:
    scene = draw_scene("mini", seed=4)
    result = localize_as_thesis(read_series(write_case(scene, tmp_path).series), ThesisFit.LINE, expected=3)
    true = np.array([fiducial.centre_ct_mm for fiducial in scene.head.fiducials])
    distance = np.linalg.norm(result.centres_mm[:, None] - true[None], axis=2)
    assert distance.min(axis=0).max() < 0.3


def test_the_covariance_is_the_error_reported_in_the_thesis(volume: Volume) -> None:
    marker = localize_as_thesis(volume, ThesisFit.SPHERE).markers[0]
    assert marker.sigma_mm == pytest.approx(0.1617)


def test_an_empty_scan_and_impossible_requests_are_refused() -> None:
    empty = as_volume(Scan())
    with pytest.raises(errors.MarkerCountWrong, match="no marker found"):
        localize_as_thesis(empty, ThesisFit.LINE)
    with raises(errors.LOCALIZATION_MISUSED):
        localize_as_thesis(empty, ThesisFit.LINE, diameter_mm=1.0)


def exact_cluster(axis: int, centre: np.ndarray, outlying: int = 0) -> Cluster:
    """Cuts of a sphere of 5.75 mm, the first few of them far off."""
    heights = np.arange(-4.0, 4.5)
    centres = np.tile(centre, (len(heights), 1))
    centres[:, axis] += heights
    centres[:outlying, (axis + 1) % 3] += 3.0
    return Cluster(centres, np.sqrt(5.75**2 - heights**2), axis, centre)


def test_line_and_sphere_fits_are_exact_on_exact_circles_and_ransac_rejects_outliers() -> None:
    centre = np.array([3.0, -7.0, 11.0])
    for outlying in (0, 2):
        pair = exact_cluster(0, centre, outlying), exact_cluster(2, centre)
        np.testing.assert_allclose(fit_lines(*pair), centre, atol=1e-9)
        found, radius, share = fit_sphere(*pair)
        np.testing.assert_allclose(found, centre, atol=0.02 if outlying else 1e-9)
        assert radius == pytest.approx(5.75, abs=0.02)
        assert share > 0.8


def test_one_misplaced_circle_does_not_split_a_sphere_in_two() -> None:
    heights = np.arange(-4.5, 5.0)
    centres = np.column_stack([heights, np.zeros((len(heights), 2))])
    centres[4, 1:] = 0.5
    centres[5:, 1:] = -0.4
    radii = np.sqrt(5.75**2 - heights**2)
    (cluster,) = cluster_circles(Circles(centres, radii, 0), 5.75, 1.0)
    assert len(cluster.radii_mm) == len(heights)


@pytest.mark.parametrize("plane_mm", [0.5, 1.0, 1.5, 2.0])
def test_a_plane_without_a_circle_does_not_split_a_sphere_in_two(plane_mm: float) -> None:
    heights = np.delete(plane_mm * np.arange(-np.floor(4.5 / plane_mm), 4.6 / plane_mm), 3)
    centres = np.column_stack([heights, np.zeros((len(heights), 2))])
    circles = Circles(centres, np.sqrt(5.75**2 - heights**2), 0)
    (cluster,) = cluster_circles(circles, 5.75, plane_mm)
    assert len(cluster.radii_mm) == len(heights)
