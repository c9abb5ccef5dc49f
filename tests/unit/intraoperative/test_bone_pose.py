"""The bone of a truncated cone-beam scan finds its place in the CT, and another head is refused."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from benchmarks.scans.cone_beam import paint_cone_beam
from benchmarks.scans.postoperative import paint_before
from procedures.imaging.volume import OUTSIDE_FIELD_HU, Volume
from procedures.intraoperative.bone_pose import register_bone
from procedures.intraoperative.errors import OTHER_HEAD
from sim.phantom.cone_beam_scan import PROTOCOL, ConeBeamScan, draw_cone_beam
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import apply
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene

SEED = 1008
SMALL_CT = CtProtocol(pixel_mm=2.0, slice_mm=2.0, columns=128, rows=128, slices=100)
SMALL = PROTOCOL.model_copy(
    update={"pixel_mm": 2.0, "slice_mm": 2.0, "columns": 100, "rows": 100, "slices": 80, "noise_HU": 30.0}
)
LARGEST_MM = 1.0  # with voxels of 2 mm

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene("default", seed=SEED).model_copy(update={"ct": SMALL_CT})


@pytest.fixture(scope="module")
def scan(scene: Scene) -> ConeBeamScan:
    return draw_cone_beam(scene, spheres_in_theatre(scene), SEED, protocol=SMALL)


@pytest.fixture(scope="module")
def volume(scan: ConeBeamScan) -> Volume:
    return paint_cone_beam(scan)


def test_the_field_truncates_the_head(scan: ConeBeamScan, volume: Volume) -> None:
    outside = volume.voxels < OUTSIDE_FIELD_HU
    assert 0.15 < outside.mean() < 0.3  # a circle in its square
    head = scan.scene.head
    corner = apply(scan.pose.scan_from_head, np.array(head.centre_ct_mm) - (0.0, 0.0, head.semi_axes_mm[2]))
    assert not volume.geometry.contains(corner)


def test_a_truncated_scan_is_placed_in_the_ct_by_its_bone(
    scene: Scene, scan: ConeBeamScan, volume: Volume
) -> None:
    found = register_bone(paint_before(scene), volume)
    targets_mm = np.array([one.target_ct_mm for one in scene.head.targets])
    off_mm = found.pose.ct_from_scan.apply(apply(scan.pose.scan_from_head, targets_mm)) - targets_mm
    assert np.linalg.norm(off_mm, axis=1).max() < LARGEST_MM
    expected = found.pose.covariances_mm2(targets_mm)
    assert (
        np.mean([one @ np.linalg.solve(two, one) / 3.0 for one, two in zip(off_mm, expected, strict=True)])
        < 3.0
    )


@pytest.mark.hazard(68)
def test_the_scan_of_another_head_is_refused(scene: Scene, volume: Volume) -> None:
    other = scene.model_copy(
        update={"head": scene.head.model_copy(update={"semi_axes_mm": (85.0, 80.0, 100.0)})}
    )
    with raises(OTHER_HEAD):
        register_bone(paint_before(other), volume)
