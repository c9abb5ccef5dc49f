"""Scanner faults change the slices, and the case records which faults were requested."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from coded_errors import raises
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from procedures.imaging import read_series
from procedures.imaging.errors import GANTRY_TILTED
from ronna_hw.arrays import Array
from sim.errors import BAD_SCENE
from sim.phantom.case import write_case
from sim.phantom.head.anatomy import draw_anatomy
from sim.phantom.head.shapes import Ball, Rod
from sim.phantom.scan import Planes, Scan
from sim.phantom.scanner.faults import KERNELS, ScannerFaults
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.phantom.scanner.metal_artefacts import METALS, MetalArtefacts, MetalPart
from sim.world.scene.model import Scene


def scan_of(scene: Scene, **faults: Any) -> Scan:
    """A scan without noise."""
    quiet = scene.model_copy(update={"ct": scene.ct.model_copy(update={"noise_HU": 0.0})})
    return Scan(quiet, place_grid(quiet.head, quiet.ct), draw_anatomy(quiet), faults=ScannerFaults(**faults))


def planes_of(scene: Scene, **faults: Any) -> Planes:
    planes = Planes(scan_of(scene, **faults))
    with ThreadPoolExecutor(1) as pool:
        planes.paint_patches(pool)
    return planes


def slices(scene: Scene, **faults: Any) -> NDArray[np.float64]:
    planes = planes_of(scene, **faults)
    return np.stack([planes.paint(number) for number in range(scene.ct.slices)])


@pytest.fixture(scope="module")
def plain(coarse_scene: Scene) -> NDArray[np.float64]:
    """The slices of a scanner without faults."""
    found = slices(coarse_scene)
    found.flags.writeable = False
    return found


def sharpness(images: NDArray[np.float64], axis: int) -> float:
    return float(np.square(np.diff(images, axis=axis)).mean())


def test_only_requested_faults_are_recorded_by_name(coarse_scene: Scene) -> None:
    assert planes_of(coarse_scene).active() == {}
    assert planes_of(coarse_scene, table_scale=0.01).active() == {"scanner": {"table_scale": 0.01}}


def test_a_table_that_overfeeds_shows_a_slice_from_further_along(
    coarse_scene: Scene, plain: NDArray[np.float64]
) -> None:
    fed = planes_of(coarse_scene, table_scale=0.5).paint(10)
    # The tenth slice lies where the fifteenth would.
    assert np.abs(fed - plain[15]).mean() < 0.1 * np.abs(fed - plain[10]).mean()


def test_a_stretched_image_shows_what_is_nearer_to_its_middle(
    coarse_scene: Scene, plain: NDArray[np.float64]
) -> None:
    size, share, along = np.array(plain.shape), 0.05, np.array([0.6, -0.4, 0.7])  # L, P, S
    shown = slices(coarse_scene, stretch=share, stretch_along=tuple(along))
    grid = scan_of(coarse_scene).grid
    spacing = np.array([grid.slice_mm, grid.pixel_mm, grid.pixel_mm])
    across = along[::-1] / np.linalg.norm(along)
    places = (np.indices(plain.shape).reshape(3, -1).T - 0.5 * (size - 1)) * spacing
    nearer = places - share / (1.0 + share) * np.outer(places @ across, across)
    expected = map_coordinates(plain, (nearer / spacing + 0.5 * (size - 1)).T, order=3, mode="nearest")
    unlike = np.abs(shown.ravel() - expected).mean()
    assert unlike < 0.2 * np.abs(shown - plain).mean()


def test_a_scan_is_either_stretched_or_tilted_and_in_a_direction() -> None:
    with raises(BAD_SCENE, match="either tilted or stretched"):
        ScannerFaults(stretch=0.01, tilt_deg=1.0)
    with raises(BAD_SCENE, match="along a direction"):
        ScannerFaults(stretch=0.01, stretch_along=(0.0, 0.0, 0.0))


def test_a_patient_motion_changes_the_slices_from_one_slice_on(
    coarse_scene: Scene, plain: NDArray[np.float64]
) -> None:
    moving = planes_of(coarse_scene, motion_mm=6.0)
    first = moving.moved_from
    assert np.linalg.norm(moving.moved_by_mm) == pytest.approx(6.0)
    np.testing.assert_array_equal(moving.paint(first - 1), plain[first - 1])
    assert np.abs(moving.paint(first) - plain[first]).mean() > 1.0


def test_a_patient_may_slide_along_the_table_only(coarse_scene: Scene) -> None:
    sliding = planes_of(coarse_scene, slide_mm=-2.0)
    assert sliding.moved_by_mm == (0.0, 0.0, -2.0)
    assert sliding.active()["scanner"]["moved_from_slice"] == sliding.moved_from > 0


def test_thick_slices_blur_along_the_table_and_a_soft_kernel_in_the_slice(
    coarse_scene: Scene, plain: NDArray[np.float64]
) -> None:
    thick = slices(coarse_scene, thickness_mm=3.0 * coarse_scene.ct.slice_mm)
    assert sharpness(thick, 0) < 0.8 * sharpness(plain, 0)
    soft = slices(coarse_scene, kernel="smooth")
    assert sharpness(soft, 2) < sharpness(plain, 2) < sharpness(slices(coarse_scene, kernel="sharp"), 2)


def test_beam_hardening_darkens_the_tissue(coarse_scene: Scene, plain: NDArray[np.float64]) -> None:
    planes, some = planes_of(coarse_scene, beam_hardening=3.0), slice(None, None, 8)
    hard = np.stack([planes.paint(number) for number in range(coarse_scene.ct.slices)[some]])
    tissue = (plain[some] > 0.0) & (plain[some] < 100.0)
    assert (hard - plain[some])[tissue].mean() < -1.0


MIDDLE = 26  # a slice whose tilted rows stay within the straight ones


def series_of(scene: Scene, folder: Path, **faults: Any) -> Path:
    scan = scan_of(scene, **faults)
    return write_case(scan.scene, folder, scan=scan).series


def middle_of(series: Path) -> pydicom.Dataset:
    return pydicom.dcmread(sorted(series.glob("*.dcm"))[MIDDLE])


def hu_where_the_header_says(scene: Scene, plain: NDArray[np.float64], data: pydicom.Dataset) -> Any:
    """What an upright scan has at each pixel's place."""
    right, down = np.array(data.ImageOrientationPatient, dtype=float).reshape(2, 3)
    first_mm = np.array(data.ImagePositionPatient, dtype=float)
    steps_mm = float(data.PixelSpacing[0]) * np.arange(data.Rows)
    places_mm = first_mm + steps_mm[:, None, None] * down + steps_mm[None, :, None] * right
    grid = place_grid(scene.head, scene.ct)
    index = (places_mm - grid.origin_mm) / (grid.pixel_mm, grid.pixel_mm, grid.slice_mm)
    return map_coordinates(plain, np.moveaxis(index[..., ::-1], -1, 0), order=1, mode="nearest")


@pytest.mark.parametrize("tilt_deg", [10.0, -10.0])
def test_a_tilted_slice_shows_what_is_where_its_header_says(
    coarse_scene: Scene, plain: NDArray[np.float64], tmp_path: Path, tilt_deg: float
) -> None:
    painted = planes_of(coarse_scene, tilt_deg=tilt_deg).paint(MIDDLE)
    data = middle_of(series_of(coarse_scene, tmp_path, tilt_deg=tilt_deg))
    assert float(data.GantryDetectorTilt) == tilt_deg
    np.testing.assert_allclose(painted, hu_where_the_header_says(coarse_scene, plain, data), atol=1.0)
    assert np.abs(painted - plain[MIDDLE]).max() > 500.0  # it is another section


def test_the_headers_of_a_hidden_tilt_are_those_of_an_upright_scan(
    coarse_scene: Scene, tmp_path: Path
) -> None:
    hidden = middle_of(series_of(coarse_scene, tmp_path / "hidden", tilt_deg=10.0, tilt_hidden=True))
    tilted = middle_of(series_of(coarse_scene, tmp_path / "tilted", tilt_deg=10.0))
    upright = middle_of(series_of(coarse_scene, tmp_path / "upright"))
    np.testing.assert_array_equal(hidden.pixel_array, tilted.pixel_array)
    assert hidden.ImageOrientationPatient == upright.ImageOrientationPatient != tilted.ImageOrientationPatient
    assert hidden.ImagePositionPatient == upright.ImagePositionPatient != tilted.ImagePositionPatient
    assert "GantryDetectorTilt" not in hidden


@pytest.mark.parametrize("stated", [True, False])
def test_a_series_painted_with_tilt_is_refused_whether_or_not_the_scanner_states_it(
    coarse_scene: Scene, tmp_path: Path, stated: bool
) -> None:
    series = series_of(coarse_scene, tmp_path, tilt_deg=5.0)
    if not stated:
        for path in series.glob("*.dcm"):
            data = pydicom.dcmread(path)
            del data.GantryDetectorTilt
            data.save_as(path)
    with raises(GANTRY_TILTED, match="5") as refused:
        read_series(series)
    assert refused.value.code == "CT-007"


def test_metal_is_cut_off_at_3071_hu_unless_the_range_is_extended(
    coarse_scene: Scene, tmp_path: Path
) -> None:
    painted = slices(coarse_scene)
    assert painted.max() > 3500.0
    usual = read_series(series_of(coarse_scene, tmp_path / "usual")).voxels
    extended = read_series(series_of(coarse_scene, tmp_path / "wide", extended_range=True)).voxels
    np.testing.assert_array_equal(extended, np.maximum(np.rint(painted), -1024.0))
    np.testing.assert_array_equal(usual, np.minimum(extended, 3071))
    assert middle_of(tmp_path / "usual" / "ct").BitsStored == 12
    assert middle_of(tmp_path / "wide" / "ct").BitsStored == 16


@pytest.mark.parametrize("faults", [{"tilt_deg": 31.0}, {"tilt_hidden": True}, {"kernel": "crisp"}])
def test_impossible_scanner_faults_are_refused(faults: dict[str, Any]) -> None:
    with raises(BAD_SCENE):
        ScannerFaults(**faults)


GRID = CtGrid((-63.5, -63.5, 0.0), 1.0, 1.0, 128, 128, 24)
HEIGHT = 12
PAIR_X = (-9.0, 9.0)


def screws(metal: str, radius_mm: float = 1.6) -> tuple[MetalPart, ...]:
    """Two upright screws 18 mm apart, from slice 6 to 18."""
    return tuple(
        MetalPart(Rod(3500.0, (x, 0.0, 6.0), (0.0, 0.0, 1.0), 12.0, radius_mm), METALS[metal]) for x in PAIR_X
    )


def artefacts(parts: tuple[MetalPart, ...], number: int = HEIGHT, noise_HU: float = 5.0) -> Array:
    """Artefact, in HU, of one slice of a water disc."""
    x, y = GRID.x_mm, GRID.y_mm
    water = np.where(np.hypot(x, y[:, None]) < 50.0, 0.0, -1000.0).astype(np.float32)
    image = water.copy()
    scanner = MetalArtefacts(parts, ((0.0, 0.0, 12.0),), GRID, KERNELS["standard"], 1.0, noise_HU)
    scanner.add(image, number, np.random.default_rng(1))
    return np.asarray(image - water, dtype=np.float64)


def mean_hu(added: Array, x_mm: float, y_mm: float, half_mm: float = 2.5) -> float:
    across = np.abs(GRID.x_mm - x_mm) < half_mm
    down = np.abs(GRID.y_mm - y_mm) < half_mm
    return float(added[np.ix_(down, across)].mean())


def test_between_two_screws_it_is_darker_than_beside_them() -> None:
    added = artefacts(screws("titanium"))
    assert mean_hu(added, 0.0, 0.0) < -30.0
    assert mean_hu(added, 0.0, 0.0) < mean_hu(added, 0.0, 15.0) - 30.0


def test_steel_casts_a_deeper_shadow_than_titanium_and_a_thick_screw_than_a_thin_one() -> None:
    thin, thick, steel = (
        mean_hu(artefacts(one), 0.0, 0.0)
        for one in (screws("titanium", 1.2), screws("titanium", 2.0), screws("steel", 2.0))
    )
    assert steel < thick < thin < 0.0


def test_few_photons_behind_metal_make_streaks_along_the_line_through_it() -> None:
    quiet, noisy = (artefacts(screws("steel", 2.0), noise_HU=one) for one in (5.0, 60.0))
    streaks = noisy - quiet
    along = np.ix_(np.abs(GRID.y_mm) < 2.0, np.abs(GRID.x_mm) > 14.0)
    across = np.ix_(np.abs(GRID.y_mm) > 14.0, np.abs(GRID.x_mm) < 2.0)
    assert streaks[along].std() > 2.0 * streaks[across].std()


@pytest.mark.parametrize("number", [2, 22])
def test_a_slice_without_metal_keeps_every_digit(number: int) -> None:
    assert not artefacts(screws("steel"), number).any()


def test_a_filling_as_wide_as_the_screw_is_long_streaks_in_its_own_slices() -> None:
    filling = (MetalPart(Ball(8000.0, (0.0, 0.0, 12.0), 3.0), METALS["amalgam"]),)
    assert np.abs(artefacts(filling)).max() > 100.0
    assert not artefacts(filling, 17).any()
