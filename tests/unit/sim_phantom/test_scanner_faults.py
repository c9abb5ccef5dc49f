"""Scanner faults change the slices, and the case records which faults were requested."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.errors import BadScene
from sim.phantom.head.anatomy import draw_anatomy
from sim.phantom.scan import Scan
from sim.phantom.scanner.faults import ScannerFaults
from sim.phantom.scanner.grid import place_grid
from sim.phantom.scanner.planes import Planes
from sim.world.scene.model import Scene


def planes_of(scene: Scene, **faults: Any) -> Planes:
    quiet = scene.model_copy(update={"ct": scene.ct.model_copy(update={"noise_HU": 0.0})})
    planes = Planes(
        Scan(quiet, place_grid(quiet.head, quiet.ct), draw_anatomy(quiet), faults=ScannerFaults(**faults))
    )
    with ThreadPoolExecutor(1) as pool:
        planes.paint_patches(pool)
    return planes


def slices(scene: Scene, **faults: Any) -> NDArray[np.float64]:
    planes = planes_of(scene, **faults)
    return np.stack([planes.paint(number) for number in range(scene.ct.slices)])


def sharpness(images: NDArray[np.float64], axis: int) -> float:
    return float(np.square(np.diff(images, axis=axis)).mean())


def test_only_requested_faults_are_recorded_by_name(coarse_scene: Scene) -> None:
    assert planes_of(coarse_scene).active() == {}
    assert planes_of(coarse_scene, table_scale=0.01).active() == {"scanner": {"table_scale": 0.01}}


def test_a_table_that_overfeeds_shows_a_slice_from_further_along(coarse_scene: Scene) -> None:
    plain, fed = slices(coarse_scene), planes_of(coarse_scene, table_scale=0.5).paint(10)
    # The tenth slice lies where the fifteenth would.
    assert np.abs(fed - plain[15]).mean() < 0.1 * np.abs(fed - plain[10]).mean()


def test_a_patient_motion_changes_the_slices_from_one_slice_on(coarse_scene: Scene) -> None:
    plain, moving = slices(coarse_scene), planes_of(coarse_scene, motion_mm=6.0)
    first = moving.moved_from
    assert np.linalg.norm(moving.moved_by_mm) == pytest.approx(6.0)
    np.testing.assert_array_equal(moving.paint(first - 1), plain[first - 1])
    assert np.abs(moving.paint(first) - plain[first]).mean() > 1.0


def test_thick_slices_blur_along_the_table_and_a_soft_kernel_in_the_slice(coarse_scene: Scene) -> None:
    plain = slices(coarse_scene)
    thick = slices(coarse_scene, thickness_mm=3.0 * coarse_scene.ct.slice_mm)
    assert sharpness(thick, 0) < 0.8 * sharpness(plain, 0)
    soft = slices(coarse_scene, kernel="smooth")
    assert sharpness(soft, 2) < sharpness(plain, 2) < sharpness(slices(coarse_scene, kernel="sharp"), 2)


def test_beam_hardening_darkens_the_tissue(coarse_scene: Scene) -> None:
    plain, hard = slices(coarse_scene), slices(coarse_scene, beam_hardening=3.0)
    tissue = (plain > 0.0) & (plain < 100.0)
    assert (hard - plain)[tissue].mean() < -1.0


@pytest.mark.parametrize("faults", [{"tilt_deg": 31.0}, {"kernel": "crisp"}])
def test_impossible_scanner_faults_are_refused(faults: dict[str, Any]) -> None:
    with pytest.raises(BadScene):
        ScannerFaults(**faults)
