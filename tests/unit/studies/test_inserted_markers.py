"""Markers inserted into a series: what is measured of its scanner, where they are found, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from procedures.imaging import Volume, VoxelGeometry, localize
from sim.phantom.scanner.dicom_series import DicomSeries
from sim.phantom.scanner.grid import CtGrid
from sim.world.scene.model import CtProtocol
from sim.world.scene.named_scenes import draw_scene
from studies.errors import SERIES_WITHOUT_ROOM, SERIES_WITHOUT_SCALE
from studies.localization.inserted_markers import InsertedMarker, insert_markers
from studies.localization.scanner_of_series import SeriesScanner, measure_scanner
from studies.localization.series_study import MARKERS, SeriesStudy, place_markers

SPACING = np.array([1.5, 0.8, 0.8])
BLUR_MM, NOISE_HU = 0.6, 12.0


def volume_of(voxels: np.ndarray) -> Volume:
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    whole = np.rint(voxels).astype(np.int16)
    whole.flags.writeable = False
    return Volume(whole, VoxelGeometry(whole.shape, np.zeros(3), axes, SPACING), "1.2.3", "1.2.4")


def head(semi_mm: tuple[float, float] = (62.0, 54.0), slices: int = 70) -> Volume:
    """A column of brain in air, blurred and noisy."""
    y, x = (SPACING[1] * (np.arange(240) - 119.5) for _ in range(2))
    depth = 1.0 - np.hypot(y[:, None] / semi_mm[0], x / semi_mm[1])
    one = np.where(depth > 0.0, 35.0, -1000.0)
    sharp = gaussian_filter(np.kron(one, np.ones((4, 4))), BLUR_MM / SPACING[1] * 4.0)
    blurred = sharp.reshape(240, 4, 240, 4).mean(axis=(1, 3))
    noise = np.random.default_rng(3).standard_normal((slices, *blurred.shape))
    noise = gaussian_filter1d(gaussian_filter1d(noise, 0.6, axis=1), 0.6, axis=2)
    return volume_of(blurred + NOISE_HU * noise / noise.std())


@pytest.fixture(scope="module")
def scanner() -> SeriesScanner:
    return measure_scanner(head())


def test_blur_and_noise_are_those_of_the_scan(scanner: SeriesScanner) -> None:
    with_pixel = np.hypot(BLUR_MM, SPACING[1] / np.sqrt(12.0))
    assert scanner.blur_mm == pytest.approx(with_pixel, rel=0.15)
    assert scanner.noise_hu == pytest.approx(NOISE_HU, rel=0.1)


@pytest.mark.parametrize(("post", "most_mm"), [("polymer", 0.03), ("titanium", 0.06)])
def test_a_marker_is_found_where_it_was_inserted(scanner: SeriesScanner, post: str, most_mm: float) -> None:
    centre = np.array([52.3, 119.5 * 0.8 + 62.0 + 14.0, 95.1])
    down = np.array([0.1, -1.0, 0.15]) / np.linalg.norm([0.1, -1.0, 0.15])
    length_mm = 11.5 if post == "polymer" else 21.5
    marker = InsertedMarker(centre, down, post, 1.6, length_mm, 1.05)
    voxels = insert_markers(scanner, [marker], np.random.default_rng(1))
    voxels.flags.writeable = False
    (found,) = localize(replace(scanner.volume, voxels=voxels)).markers
    assert np.linalg.norm(np.array(found.centre_mm) - centre[::-1]) < most_mm


def test_markers_are_placed_apart_in_air(scanner: SeriesScanner) -> None:
    markers = place_markers(scanner, "polymer", np.random.default_rng(2))
    centres = np.array([one.centre_mm for one in markers])
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + 1e9 * np.eye(MARKERS)
    assert apart.min() > 35.0


def test_few_slices_are_refused() -> None:
    with raises(SERIES_WITHOUT_SCALE):
        measure_scanner(head(slices=12))


def test_a_head_that_fills_the_field_is_refused() -> None:
    with raises(SERIES_WITHOUT_ROOM):
        place_markers(measure_scanner(head((126.0, 126.0))), "polymer", np.random.default_rng(2))


def test_air_without_a_head_is_refused() -> None:
    with raises(SERIES_WITHOUT_ROOM):
        measure_scanner(volume_of(np.full((40, 120, 120), -1000.0)))


def test_another_series_at_the_same_path_is_another_study(tmp_path: Path) -> None:
    grid, tiny = (
        CtGrid((0.0, 0.0, 0.0), 1.0, 1.0, 16, 16, 1),
        CtProtocol(pixel_mm=1.0, slice_mm=1.0, columns=16, rows=16, slices=1),
    )
    found = []
    for seed in (1000, 1000, 1001):
        scene = draw_scene("default", seed=seed).model_copy(update={"ct": tiny})
        series = DicomSeries(scene, grid, tmp_path, date="20180601", occasion="the CT")
        series.prepare()
        series.write(0, np.zeros((16, 16), "<u2"))
        found.append(SeriesStudy(str(tmp_path), 1, 7).settings())
    assert found[0] == found[1]
    assert found[2]["series_sha256"] != found[0]["series_sha256"]
    assert found[2]["series_instance_uid"] != found[0]["series_instance_uid"]
