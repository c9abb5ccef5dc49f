from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from sim.errors import BAD_SCENE
from sim.phantom.head.faced_layers import layers_of
from sim.world.head_surface.surface import HeadSurface
from sim.world.head_surface.volume_head import CtImage, VolumeHead, read_head
from sim.world.options import Carrier
from sim.world.scene.model import Head
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import head_extent, skin_in_ct

ROOM_MM, SPACING_MM, HALF_HEIGHT_MM = 15.0, 1.25, 35.0
EDGE_MM = 0.7  # of the scanner's blur


@pytest.fixture(scope="module")
def skin() -> HeadSurface:
    return skin_in_ct(shaved_head())


@pytest.fixture(scope="module")
def image() -> CtImage:
    """A CT of eyes to mouth, without noise, with a rod beside the head."""
    head = shaved_head()
    low, high = head_extent(head)
    middle = head.centre_ct_mm[2] - 50.0
    x, y = (
        np.arange(start - ROOM_MM, end + ROOM_MM, SPACING_MM).astype(np.float32)
        for start, end in zip(low[:2], high[:2], strict=True)
    )
    z = np.arange(middle - HALF_HEIGHT_MM, middle + HALF_HEIGHT_MM, SPACING_MM).astype(np.float32)
    layers = layers_of(head, EDGE_MM)
    hu = np.stack([layers.hu_at(x[:, None], y[None, :], one[None]) for one in np.split(z, len(z))], axis=2)
    hu[:3, :3] = 150.0
    return CtImage(hu, np.array([x[0], y[0], z[0]], dtype=float), np.full(3, SPACING_MM))


def shaved_head() -> Head:
    head = draw_scene("mini", seed=2, fiducials=Carrier.SURFACE).head
    assert head.face is not None
    return head.model_copy(update={"face": head.face.model_copy(update={"hair_mm": 0.0})})


def test_rays_meet_the_skin_of_a_ct_between_its_voxels(image: CtImage, skin: HeadSurface) -> None:
    read = VolumeHead(image)
    generator = np.random.default_rng(1)
    middle = image.first_mm + 0.5 * np.array(image.hu.shape) * SPACING_MM
    back = np.array([0.4, -0.9, 0.0]) / np.linalg.norm([0.4, -0.9])
    origins = middle + 400.0 * back + generator.uniform(-25.0, 25.0, (300, 3))
    along = np.tile(-back, (len(origins), 1))
    found = read.cast(origins, along, 800.0)
    met = np.isfinite(found)
    places = (origins + found[:, None] * along)[met]
    assert met.mean() > 0.4
    facing = read.normals(places) @ back > 0.5
    away = skin.distance_mm(places)[facing]
    assert np.abs(np.median(away)) < 0.03
    assert np.quantile(np.abs(away), 0.9) < 0.15
    assert np.abs(read.distance_mm(places)).max() < 0.01


def test_what_does_not_hang_together_with_the_head_is_air(image: CtImage) -> None:
    read = VolumeHead(image)
    on_rod = np.add(image.first_mm, (1.0, 1.0, 30.0))
    assert read.distance_mm(on_rod[None])[0] > 10.0


def test_a_folder_without_slices_is_no_head(tmp_path: Path) -> None:
    with raises(BAD_SCENE, match="no CT series"):
        read_head(tmp_path)
