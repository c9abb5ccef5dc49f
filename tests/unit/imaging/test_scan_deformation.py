"""A scan stretched or sheared as a whole shows in its spheres; what they leave open is stated, not hidden."""

from __future__ import annotations

from dataclasses import replace
from math import tan

import numpy as np
import pytest
from localized_spheres import as_volume
from painted_ct import Scan
from scipy.ndimage import shift

from procedures.imaging import Localization, Volume, localize, localize_picks
from procedures.imaging.errors import ScanDeformed
from procedures.imaging.markers import ScanDeformation
from procedures.imaging.scan_deformation import (
    ALIKE,
    PIXEL_SIZE,
    TABLE_FEED,
    combine_spheres,
    open_strains,
    require_undeformed,
)
from procedures.imaging.sphere_centre.ball_model import Stretch
from procedures.imaging.volume import VoxelGeometry
from ronna_hw.arrays import Array

RADIUS_MM, PIXEL_MM = 5.75, 0.5
AXIAL = np.eye(3)[:, ::-1]  # slices along S
GEOMETRY = VoxelGeometry((40, 100, 100), np.zeros(3), AXIAL, np.array([1.0, PIXEL_MM, PIXEL_MM]))
ALONG_TABLE = np.diag([-1.0, -1.0, 2.0]) / 3.0  # longer along S by a unit of length
ACROSS_TABLE = np.diag([1.0, -1.0, 0.0]) / 2.0  # longer along L than along P by a unit of length
BLUR_MM = 0.455  # of slices of 1 mm
SURE, UNSURE = 5e-4, 5e-3  # of the radius


def scan_with(places: int, *, feed: float = 1.0, tilt_deg: float = 0.0) -> Volume:
    """Spheres scanned by a table that feeds this many times what is stated, in slices slipped by a tilt."""
    scan = Scan(shape=(40, 100, 100), spacing_mm=(feed, PIXEL_MM, PIXEL_MM))
    for row_mm, column_mm in ((14.0, 14.0), (14.2, 35.9), (35.8, 14.3), (36.0, 36.1))[:places]:
        scan.ball(np.array([20.0, row_mm, column_mm]))
    volume: Volume = as_volume(scan, axes=AXIAL)
    slipped = tan(np.radians(tilt_deg)) / PIXEL_MM * (np.arange(40) - 20.0)
    planes = [
        shift(plane.astype(float), (pixels, 0.0), order=3, mode="nearest")
        for plane, pixels in zip(volume.voxels, slipped, strict=True)
    ]
    stated = replace(volume.geometry, spacing_mm=np.array([1.0, PIXEL_MM, PIXEL_MM]))
    return replace(volume, voxels=np.rint(planes).astype(np.int16), geometry=stated)


def strain_of(found: Localization) -> Array:
    assert found.deformation is not None
    return np.array(found.deformation.strain)


def spheres(*strains: Array, sigma: float = SURE, geometry: VoxelGeometry = GEOMETRY) -> ScanDeformation:
    """The result of spheres measured with these strains, LPS, each with one sigma."""
    rows, columns = [0, 1, 0, 0, 1], [0, 1, 1, 2, 2]
    turned = [RADIUS_MM * geometry.axes.T @ one @ geometry.axes for one in strains]
    terms = [one[rows, columns] * [1.0, 1.0, 2.0, 2.0, 2.0] for one in turned]
    measured = [Stretch(one, (RADIUS_MM * sigma) ** 2 * ALIKE, BLUR_MM) for one in terms]
    found = combine_spheres(measured, RADIUS_MM, geometry)
    assert found is not None
    return found


def displacement(strains: Array, place: tuple[float, float, float]) -> float:
    """Rms displacement per unit of length of a place by open strains."""
    return float(np.linalg.norm(strains @ np.array(place)))


def test_a_scan_true_to_scale_passes() -> None:
    require_undeformed(localize(scan_with(4), expected=4).deformation)


@pytest.mark.parametrize("feed", [1.015, pytest.param(0.985, marks=pytest.mark.slow)])
def test_three_spheres_show_a_feed_off_by_one_and_a_half_percent(feed: float) -> None:
    found = localize(scan_with(3, feed=feed), expected=3)
    np.testing.assert_allclose(strain_of(found), (1.0 / feed - 1.0) * ALONG_TABLE, atol=1.5e-3)
    with pytest.raises(ScanDeformed, match=r"CT-024: by the shape of 3 spheres .* limit 0\.[2-8]\d* %"):
        require_undeformed(found.deformation)


def test_a_hidden_tilt_shows_as_the_shear_that_it_is() -> None:
    volume = scan_with(4, tilt_deg=0.6)
    found = localize(volume, expected=4)
    strain = strain_of(found)
    assert strain[1, 2] == pytest.approx(0.5 * np.radians(0.6), rel=0.2)
    assert abs(strain[2, 2]) < 2e-3
    with pytest.raises(ScanDeformed, match="table feed, pixel size and gantry tilt"):
        require_undeformed(localize_picks(volume, found.centres_mm).deformation)


def test_the_strain_is_that_of_the_patient_however_the_slices_lie() -> None:
    strain = np.array([[3.0, 1.0, 0.5], [1.0, -2.0, -1.5], [0.5, -1.5, -1.0]]) * 1e-3
    axial = spheres(strain, strain)
    coronal = spheres(strain, strain, geometry=replace(GEOMETRY, axes=np.eye(3)[:, [1, 0, 2]]))
    np.testing.assert_allclose(axial.strain, strain, atol=1e-12)
    np.testing.assert_allclose(coronal.strain, strain, atol=1e-12)


def test_one_odd_sphere_is_no_deformed_scan_but_leaves_more_open() -> None:
    alike, odd = spheres(*[0.0 * ALONG_TABLE] * 5), spheres(*[0.0 * ALONG_TABLE] * 4, 0.014 * ALONG_TABLE)
    require_undeformed(odd)
    assert np.trace(odd.covariance) > 3.0 * np.trace(alike.covariance)


def test_more_spheres_show_less_of_a_stretch() -> None:
    strain = 0.0018 * ACROSS_TABLE
    require_undeformed(spheres(*[strain] * 3))
    with pytest.raises(ScanDeformed):
        require_undeformed(spheres(*[strain] * 8))


def test_spheres_without_a_shape_leave_what_a_scanner_usually_errs_by() -> None:
    assert combine_spheres([None, None], RADIUS_MM, GEOMETRY) is None
    strains = open_strains(None)
    assert displacement(strains, (0.0, 0.0, 1.0)) > TABLE_FEED
    assert np.sqrt((strains[:, 2, 2] ** 2).sum()) == pytest.approx(TABLE_FEED)


def test_what_shapes_have_shown_is_open_no_more_but_a_common_scale_stays() -> None:
    strains = open_strains(spheres(*[0.0 * ALONG_TABLE] * 8))
    scale = np.trace(strains, axis1=1, axis2=2) / 3.0
    rest = strains - scale[:, None, None] * np.eye(3)
    assert np.sqrt((rest**2).sum(axis=0)).max() < 4e-4
    both = 1.0 / np.hypot(1.0 / TABLE_FEED, 1.0 / PIXEL_SIZE)  # pixels and table would have to err alike
    assert np.linalg.norm(scale) == pytest.approx(both, rel=0.1)


def test_uncertain_shapes_do_not_make_a_scanner_worse_than_usual() -> None:
    unsure = open_strains(spheres(0.0 * ALONG_TABLE, sigma=UNSURE))
    for place in np.eye(3):
        assert displacement(unsure, tuple(place)) <= displacement(open_strains(None), tuple(place)) + 1e-9


def test_a_deformation_that_passes_counts_in_full_since_nothing_is_corrected() -> None:
    shown, none = spheres(*[0.0012 * ACROSS_TABLE] * 3), spheres(*[0.0 * ACROSS_TABLE] * 3)
    require_undeformed(shown)
    more, usual = (open_strains(one)[:, 0, 0] - open_strains(one)[:, 1, 1] for one in (shown, none))
    added = np.linalg.norm(more) ** 2 - np.linalg.norm(usual) ** 2
    assert np.sqrt(added) == pytest.approx(0.0012, rel=0.15)
