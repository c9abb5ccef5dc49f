"""A patient who moves during the scan is detected and refused; one who lies still raises no warning."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from localized_spheres import as_volume
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

from procedures.imaging import Volume, localize, read_series
from procedures.imaging.errors import PatientMoved, SlicesMisplaced
from procedures.imaging.scan_faults import check_distortion, check_motion, measure_distortion
from procedures.imaging.sphere_centre.ball_model import Stretch
from procedures.imaging.volume import VoxelGeometry

SHAPE = (24, 120, 120)
PIXEL_MM = 1.0
OBLIQUE = (0.6, 0.8)  # a unit vector down the rows and across the columns


def head(
    moved_mm: float,
    slice_mm: float = 1.0,
    seed: int = 0,
    *,
    way: tuple[float, float] = OBLIQUE,
    slid_mm: float = 0.0,
    noise_hu: float = 20.0,
) -> tuple[NDArray[np.int16], VoxelGeometry]:
    """An egg of soft tissue in a skull; from the thirteenth slice on it lies elsewhere."""
    z, y, x = (np.arange(n, dtype=float) for n in SHAPE)
    values = np.empty(SHAPE)
    for number, stated_mm in enumerate(z * slice_mm + 30.0):
        after = number >= SHAPE[0] // 2
        aside = moved_mm / PIXEL_MM if after else 0.0
        height = stated_mm + (slid_mm if after else 0.0)
        off = np.sqrt(
            ((y[:, None] - 59.0 - way[0] * aside) / 45.0) ** 2
            + ((x[None, :] - 60.0 - way[1] * aside) / 38.0) ** 2
            + (height / 60.0) ** 2
        )
        values[number] = np.where(off < 0.9, 40.0, np.where(off < 1.0, 900.0, -1000.0))
        values[number] = gaussian_filter(values[number], 0.8)
    values += noise_hu * np.random.default_rng(seed).standard_normal(SHAPE)
    geometry = VoxelGeometry(SHAPE, np.zeros(3), np.eye(3), np.array([slice_mm, PIXEL_MM, PIXEL_MM]))
    return values.astype(np.int16), geometry


def test_a_small_movement_is_reported_with_its_size_and_location() -> None:
    (warning,) = check_motion(*head(0.7))
    told_mm = float(warning.split("moved by ")[1].split(" mm")[0])
    assert told_mm == pytest.approx(0.7, rel=0.3)
    assert "between slices 12 and 13" in warning


@pytest.mark.parametrize("way", [OBLIQUE, (1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("moved_mm", [1.5, 3.0])
def test_a_movement_by_more_than_a_millimetre_is_refused_with_its_size_and_location(
    moved_mm: float, way: tuple[float, float]
) -> None:
    with pytest.raises(PatientMoved, match="between slices 12 and 13") as refused:
        check_motion(*head(moved_mm, way=way))
    assert refused.value.got is not None
    assert float(refused.value.got.removesuffix(" mm")) == pytest.approx(moved_mm, rel=0.3)
    assert refused.value.limit == "1.0 mm"


def test_a_movement_back_along_the_table_that_repeats_slices_is_refused() -> None:
    with pytest.raises(
        PatientMoved, match=r"back along the table at S .*, between slices 12 and 13"
    ) as refused:
        check_motion(*head(0.0, slid_mm=-3.0))
    assert refused.value.got is not None
    assert float(refused.value.got.removesuffix(" mm")) == pytest.approx(3.0, rel=0.2)


def test_a_movement_shows_in_noisy_slices_of_two_millimetres() -> None:
    with pytest.raises(PatientMoved):
        check_motion(*head(2.0, slice_mm=2.0, noise_hu=50.0))


@pytest.mark.parametrize("seed", range(4))
def test_a_patient_who_lies_still_gives_no_warning(seed: int) -> None:
    assert check_motion(*head(0.0, seed=seed)) == ()
    assert check_motion(*head(0.0, slice_mm=2.0, seed=seed, noise_hu=50.0)) == ()


def test_something_that_begins_between_two_slices_is_no_movement() -> None:
    voxels, geometry = head(0.0)
    voxels[12:, 8:12, 20:100] = 300  # a board under the head
    assert check_motion(voxels, geometry) == ()


def test_thick_slices_give_no_motion_warning() -> None:
    assert check_motion(*head(3.0, slice_mm=4.0)) == ()


def test_empty_slices_give_no_motion_warning() -> None:
    _, geometry = head(0.0)
    assert check_motion(np.full(SHAPE, -1000, dtype=np.int16), geometry) == ()


def test_a_series_of_a_patient_who_moved_is_not_read(dicom_series: Callable[..., Path]) -> None:
    voxels, geometry = head(3.0)
    with pytest.raises(PatientMoved):
        read_series(dicom_series(voxels, tuple(geometry.spacing_mm)))


Array = NDArray[np.float64]

RADIUS_MM, STACK_PIXEL_MM = 5.75, 0.5
FLAT = np.diag([-2.0, 1.0, 1.0]) / 3.0  # shorter along the table by a unit of length


def four_balls(make_scan: Callable[..., Any], *, feed: float = 1.0, tilt_deg: float = 0.0) -> Volume:
    """Scanned by a table that feeds this many times what is stated, and by slices slipped as by a tilt."""
    scan = make_scan(shape=(40, 100, 100), spacing_mm=(feed, STACK_PIXEL_MM, STACK_PIXEL_MM))
    for row_mm, column_mm in ((14.0, 14.0), (14.0, 36.0), (36.0, 14.0), (36.0, 36.0)):
        scan.ball(np.array([20.0, row_mm, column_mm]))
    volume: Volume = as_volume(scan)
    slipped = tan(np.radians(tilt_deg)) / STACK_PIXEL_MM * (np.arange(40) - 20.0)
    planes = [
        shift(plane.astype(float), (pixels, 0.0), order=3, mode="nearest")
        for plane, pixels in zip(volume.voxels, slipped, strict=True)
    ]
    stated = replace(volume.geometry, spacing_mm=np.array([1.0, STACK_PIXEL_MM, STACK_PIXEL_MM]))
    return replace(volume, voxels=np.rint(planes).astype(np.int16), geometry=stated)


def stretch(terms_mm: Array) -> Stretch:
    return Stretch(terms_mm, deviation_mm=0.0)


def test_markers_scanned_well_say_nothing(make_scan: Callable[..., Any]) -> None:
    assert localize(four_balls(make_scan), expected=4).warnings == ()


@pytest.mark.parametrize(
    ("feed", "way"), [(1.01, "more"), pytest.param(0.99, "less", marks=pytest.mark.slow)]
)
def test_a_feed_off_by_one_percent_is_told_with_its_size(
    make_scan: Callable[..., Any], feed: float, way: str
) -> None:
    (warning,) = localize(four_balls(make_scan, feed=feed), expected=4).warnings
    told = re.search(rf"of 4 markers the table seems to feed (.*) % {way} than the scanner states", warning)
    assert told is not None
    assert float(told[1]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(
    ("feed", "way"), [pytest.param(1.02, "more", marks=pytest.mark.slow), (0.98, "less")]
)
def test_a_feed_off_by_two_percent_is_refused(make_scan: Callable[..., Any], feed: float, way: str) -> None:
    with pytest.raises(SlicesMisplaced, match=rf"feed (1\.9|2\.0|2\.1) % {way}.*limit 1\.5 %"):
        localize(four_balls(make_scan, feed=feed), expected=4)


def test_a_hidden_tilt_is_told_and_from_one_degree_refused(make_scan: Callable[..., Any]) -> None:
    (warning,) = localize(four_balls(make_scan, tilt_deg=0.6), expected=4).warnings
    assert "tilted by 0.6 degrees, which the scanner does not state" in warning
    with pytest.raises(SlicesMisplaced, match=r"by 1\.2 degrees"):
        localize(four_balls(make_scan, tilt_deg=1.2), expected=4)


def test_three_markers_are_too_few() -> None:
    assert measure_distortion([stretch(0.2 * FLAT)] * 3 + [None], RADIUS_MM) is None


def test_one_odd_marker_says_nothing_about_the_scan() -> None:
    assert check_distortion([stretch(0.0 * FLAT)] * 6 + [stretch(0.3 * FLAT)], RADIUS_MM) == ()


def test_markers_that_disagree_are_not_sure() -> None:
    shapes_mm = [amount * FLAT for amount in (-0.4, 0.1, 0.3, 0.5)]
    found = measure_distortion([stretch(one) for one in shapes_mm], RADIUS_MM)
    assert found is not None
    assert found.scale > 0.03
    assert check_distortion([stretch(one) for one in shapes_mm], RADIUS_MM) == ()


def test_a_shear_is_the_same_in_every_direction_across_the_table() -> None:
    down, across = np.zeros((3, 3)), np.zeros((3, 3))
    down[0, 1] = down[1, 0] = across[0, 2] = across[2, 0] = 0.5 * 0.01 * RADIUS_MM
    for shape_mm in (down, across, (down + across) / np.sqrt(2.0)):
        found = measure_distortion([stretch(shape_mm), stretch(shape_mm)] * 2, RADIUS_MM)
        assert found is not None
        assert found.shear == pytest.approx(0.01)
        assert found.scale == pytest.approx(0.0)
