"""All markers distorted alike betray a table that feeds wrongly and a gantry that hides its tilt."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from math import tan
from typing import Any

import numpy as np
import pytest
from localized_spheres import as_volume
from numpy.typing import NDArray
from scipy.ndimage import shift

from procedures.imaging import Marker, Volume, localize
from procedures.imaging.errors import SlicesMisplaced
from procedures.imaging.scan_faults import distortion_warnings, measure_distortion

Array = NDArray[np.float64]

RADIUS_MM, PIXEL_MM = 5.75, 0.5
FLAT = np.diag([-2.0, 1.0, 1.0]) / 3.0  # shorter along the table by a unit of length


def four_balls(make_scan: Callable[..., Any], *, feed: float = 1.0, tilt_deg: float = 0.0) -> Volume:
    """Scanned by a table that feeds this many times what is stated, and by slices slipped as by a tilt."""
    scan = make_scan(shape=(40, 100, 100), spacing_mm=(feed, PIXEL_MM, PIXEL_MM))
    for row_mm, column_mm in ((14.0, 14.0), (14.0, 36.0), (36.0, 14.0), (36.0, 36.0)):
        scan.ball(np.array([20.0, row_mm, column_mm]))
    volume: Volume = as_volume(scan)
    slipped = tan(np.radians(tilt_deg)) / PIXEL_MM * (np.arange(40) - 20.0)
    planes = [
        shift(plane.astype(float), (pixels, 0.0), order=3, mode="nearest")
        for plane, pixels in zip(volume.voxels, slipped, strict=True)
    ]
    stated = replace(volume.geometry, spacing_mm=np.array([1.0, PIXEL_MM, PIXEL_MM]))
    return replace(volume, voxels=np.rint(planes).astype(np.int16), geometry=stated)


def marker(shape_mm: Array | None) -> Marker:
    return Marker(np.zeros(3), np.eye(3), RADIUS_MM, 1.0, 0.0, shape_mm=shape_mm)


def test_markers_scanned_well_say_nothing(make_scan: Callable[..., Any]) -> None:
    assert localize(four_balls(make_scan), expected=4).warnings == ()


@pytest.mark.parametrize(("feed", "way"), [(1.01, "more"), (0.99, "less")])
def test_a_feed_off_by_one_percent_is_told_with_its_size(
    make_scan: Callable[..., Any], feed: float, way: str
) -> None:
    (warning,) = localize(four_balls(make_scan, feed=feed), expected=4).warnings
    told = re.search(rf"of 4 markers the table seems to feed (.*) % {way} than the scanner states", warning)
    assert told is not None
    assert float(told[1]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("feed", "way"), [(1.02, "more"), (0.98, "less")])
def test_a_feed_off_by_two_percent_is_refused(make_scan: Callable[..., Any], feed: float, way: str) -> None:
    with pytest.raises(SlicesMisplaced, match=rf"feed (1\.9|2\.0|2\.1) % {way}.*limit 1\.5 %"):
        localize(four_balls(make_scan, feed=feed), expected=4)


def test_a_hidden_tilt_is_told_and_from_one_degree_refused(make_scan: Callable[..., Any]) -> None:
    (warning,) = localize(four_balls(make_scan, tilt_deg=0.6), expected=4).warnings
    assert "tilted by 0.6 degrees, which the scanner does not state" in warning
    with pytest.raises(SlicesMisplaced, match=r"by 1\.2 degrees"):
        localize(four_balls(make_scan, tilt_deg=1.2), expected=4)


def test_three_markers_are_too_few() -> None:
    assert measure_distortion([marker(0.2 * FLAT)] * 3 + [marker(None)], RADIUS_MM) is None


def test_one_odd_marker_says_nothing_about_the_scan() -> None:
    assert distortion_warnings([marker(0.0 * FLAT)] * 6 + [marker(0.3 * FLAT)], RADIUS_MM) == ()


def test_markers_that_disagree_are_not_sure() -> None:
    shapes_mm = [amount * FLAT for amount in (-0.4, 0.1, 0.3, 0.5)]
    found = measure_distortion([marker(one) for one in shapes_mm], RADIUS_MM)
    assert found is not None
    assert found.scale > 0.03
    assert distortion_warnings([marker(one) for one in shapes_mm], RADIUS_MM) == ()


def test_a_shear_is_the_same_in_every_direction_across_the_table() -> None:
    down, across = np.zeros((3, 3)), np.zeros((3, 3))
    down[0, 1] = down[1, 0] = across[0, 2] = across[2, 0] = 0.5 * 0.01 * RADIUS_MM
    for shape_mm in (down, across, (down + across) / np.sqrt(2.0)):
        found = measure_distortion([marker(shape_mm), marker(shape_mm)] * 2, RADIUS_MM)
        assert found is not None
        assert found.shear == pytest.approx(0.01)
        assert found.scale == pytest.approx(0.0)
