import tomllib

import numpy as np
import pytest
from coded_errors import raises
from numpy.typing import NDArray

from sim.errors import BAD_SCENE
from sim.phantom.case import mirrored, plan_toml
from sim.phantom.families.face_scan import FACE_FAMILIES, face_scan
from sim.phantom.scan import Scan, SlicePainter, plain_scan
from sim.phantom.scanner.grid import shown_mm
from sim.world.options import Carrier
from sim.world.rigid import as_point
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.skin import head_extent, head_with_face, skin_in_ct

SKIN_LEVEL_HU = -482.5  # halfway from air to skin
FINE = CtProtocol(pixel_mm=0.5, slice_mm=1.0, columns=512, rows=512, slices=261, noise_HU=0.0)
STEP_ACROSS = 0.5  # part of the normal along a row, at which edges are told from those of bone and teeth


def shaved(seed: int, fiducials: Carrier = Carrier.SURFACE) -> Scene:
    scene = draw_scene("mini", seed=seed, fiducials=fiducials)
    face = scene.head.face
    assert face is not None
    head = scene.head.model_copy(update={"face": face.model_copy(update={"hair_mm": 0.0})})
    return scene.model_copy(update={"head": head, "ct": FINE})


def edges_mm(scan: Scan, heights_mm: list[float]) -> NDArray[np.float64]:
    """Points where rows of slices at these heights above the centre cross the skin's level."""
    painter, grid = SlicePainter(scan.scene, scan.grid, scan.anatomy), scan.grid
    found = []
    for height in heights_mm:
        number = int(np.argmin(np.abs(grid.z_mm - scan.scene.head.centre_ct_mm[2] - height)))
        image = painter.clean(number).astype(float)
        rows, columns = np.nonzero(np.diff(image > SKIN_LEVEL_HU, axis=1))
        before, after = image[rows, columns], image[rows, columns + 1]
        x = grid.x_mm[columns] + grid.pixel_mm * (SKIN_LEVEL_HU - before) / (after - before)
        found.append(np.column_stack([x, grid.y_mm[rows], np.full(len(rows), grid.z_mm[number])]))
    return np.vstack(found)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_edge_of_the_head_in_the_ct_is_where_its_surface_is(seed: int) -> None:
    scan = face_scan(shaved(seed), "free", "surface")
    points = edges_mm(scan, [60.0, 10.0, -30.0, -60.0, -100.0])
    skin = skin_in_ct(scan.scene.head)
    away, across = skin.distance_mm(points), np.abs(skin.normals(points)[:, 0])
    away = away[(np.abs(away) < 1.0) & (across > STEP_ACROSS)]
    assert len(away) > 1500
    assert np.abs(np.mean(away)) < 0.01
    assert np.quantile(np.abs(away), 0.95) < 0.05


@pytest.mark.parametrize("name", FACE_FAMILIES)
def test_each_family_shows_a_whole_head_and_what_it_names(name: str) -> None:
    scan = face_scan(shaved(1, Carrier.MIXED), name, "mixed")
    low, high = head_extent(scan.scene.head)
    grid = scan.grid
    assert (np.array([grid.x_mm[0], grid.y_mm[0], grid.z_mm[0]]) < low).all()
    assert (np.array([grid.x_mm[-1], grid.y_mm[-1], grid.z_mm[-1]]) > high).all()
    family, free = FACE_FAMILIES[name], face_scan(shaved(1, Carrier.MIXED), "free", "mixed")
    more = len(scan.anatomy.surroundings) > len(free.anatomy.surroundings)
    assert more == (family.tube or family.cushion or family.pins > 0)
    face = scan.scene.head.face
    assert face is not None
    assert face.ear_folds == family.ear_folds
    assert scan.scene.head.skin_shift.ears_unfold == any(family.ear_folds)


def test_hair_lifts_the_air_above_the_skin_and_below_the_hair_line_there_is_none() -> None:
    scene = shaved(1)
    face = scene.head.face
    assert face is not None
    hairy = scene.head.model_copy(
        update={"face": face.model_copy(update={"hair_mm": 8.0, "hair_share": 0.9})}
    )
    images = [
        SlicePainter(one.scene, one.grid, one.anatomy)
        for one in (
            face_scan(scene.model_copy(update={"head": head}), "free", "surface")
            for head in (scene.head, hairy)
        )
    ]
    grid = face_scan(scene, "free", "surface").grid
    faced = head_with_face(scene.head)
    assert faced is not None
    for height, differs in ((70.0, True), (faced.landmarks.menton_mm + 10.0, False)):
        number = int(np.argmin(np.abs(grid.z_mm - scene.head.centre_ct_mm[2] - height)))
        bare, covered = (painter.clean(number) for painter in images)
        assert (np.abs(covered - bare).max() > 50.0) == differs


def test_the_plan_says_that_the_skin_is_the_fiducial() -> None:
    surface, mixed = (
        plan_toml(face_scan(shaved(1, kind), "free", kind.value), "2.25.1")
        for kind in (Carrier.SURFACE, Carrier.MIXED)
    )
    assert 'implanted = 0\nfiducials = "surface"' in surface
    assert 'implanted = 2\nfiducials = "mixed"' in mixed


def test_an_unknown_family_is_refused_with_those_there_are() -> None:
    with raises(BAD_SCENE, match="free, resting, folded"):
        face_scan(shaved(1), "bandage", "surface")


def test_a_mirrored_series_has_its_plan_on_the_other_side_of_the_field() -> None:
    scene = draw_scene("mini", seed=7, fiducials=Carrier.SURFACE)
    spoilt = scene.model_copy(update={"ct": scene.ct.model_copy(update={"mirrored": True})})
    scan, target = plain_scan(spoilt), scene.head.targets[0].target_ct_mm
    seen = np.array(shown_mm(spoilt, target))
    index = (np.array([target[0], seen[0]]) - scan.grid.x_mm[0]) / scan.grid.pixel_mm
    assert index.sum() == pytest.approx(scan.grid.columns - 1)
    assert shown_mm(spoilt, as_point(seen)) == pytest.approx(target)
    assert shown_mm(scene, target) == list(target)
    (planned,) = tomllib.loads(plan_toml(scan, "1.2.3"))["trajectories"]
    assert planned["target_mm"] == pytest.approx(seen)
    row = mirrored(lambda _number: np.arange(4, dtype=np.float32).reshape(1, 4))(0)
    assert row.tolist() == [[3.0, 2.0, 1.0, 0.0]]


def test_a_series_may_lack_its_lowest_slices() -> None:
    scene = draw_scene("mini", seed=7, fiducials=Carrier.SURFACE)
    whole = plain_scan(scene).grid
    cut = plain_scan(scene.model_copy(update={"ct": scene.ct.model_copy(update={"missing_slices": 90})})).grid
    assert cut.z_mm == pytest.approx(whole.z_mm[90:])
