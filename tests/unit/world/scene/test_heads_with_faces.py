import numpy as np
import pytest
from coded_errors import raises

from sim.errors import BAD_SCENE
from sim.world.head_surface.skin_shift import SkinShift
from sim.world.options import Carrier
from sim.world.process import load_scene
from sim.world.scene.model import parse_scene
from sim.world.scene.named_scenes import add_patient_frame, draw_scene
from sim.world.scene.skin import skin_in_ct, skin_in_theatre


@pytest.mark.parametrize("name", ["default", "mini"])
def test_a_head_with_markers_has_no_face_and_is_drawn_as_ever(name: str) -> None:
    scene, faced = draw_scene(name, seed=3), draw_scene(name, seed=3, fiducials=Carrier.SURFACE)
    assert scene.head.face is None
    assert scene.head.skin_shift.is_none
    assert scene.head.semi_axes_mm == (75.0, 95.0, 90.0)
    # Places drawn with seed 3 ever since; the face has noise of its own.
    assert scene.head.fiducials[0].centre_ct_mm == pytest.approx((24.881727, -107.001132, 894.338013))
    assert scene.head.targets[0].target_ct_mm == pytest.approx((-2.247676, -70.857449, 820.06746))
    assert scene.stand == faced.stand


@pytest.mark.parametrize(
    ("fiducials", "asked", "markers"),
    [(Carrier.SURFACE, None, 0), (Carrier.MIXED, None, 2), (Carrier.MIXED, 1, 1), (Carrier.MIXED, 3, 3)],
)
def test_with_the_skin_as_fiducial_a_head_has_a_face_and_few_spheres(
    fiducials: Carrier, asked: int | None, markers: int
) -> None:
    scene = draw_scene("default", seed=2, markers=asked, fiducials=fiducials)
    assert scene.head.face is not None
    assert len(scene.head.fiducials) == markers
    assert scene == draw_scene("default", seed=2, markers=asked, fiducials=fiducials)
    assert scene == add_patient_frame(scene)


@pytest.mark.parametrize(
    ("fiducials", "markers"), [(Carrier.SURFACE, 3), (Carrier.MIXED, 4), (Carrier.FREE, 2)]
)
def test_other_numbers_of_spheres_are_refused(fiducials: Carrier, markers: int) -> None:
    with raises(BAD_SCENE):
        draw_scene("default", markers=markers, fiducials=fiducials)


@pytest.mark.parametrize("seed", range(3))
def test_entries_and_posts_are_on_the_skin_of_the_ct(seed: int) -> None:
    head = draw_scene("default", seed=seed, markers=3, fiducials=Carrier.MIXED).head
    skin = skin_in_ct(head)
    entries = np.array([target.entry_ct_mm for target in head.targets])
    centres = np.array([one.centre_ct_mm for one in head.fiducials])
    posts = np.array([one.post_ct for one in head.fiducials])
    assert skin.distance_mm(entries) == pytest.approx(0.0, abs=2e-3)
    assert skin.distance_mm(centres - 16.0 * posts) == pytest.approx(0.0, abs=2e-3)


def test_the_skin_of_a_patient_moved_since_the_ct_and_that_of_a_phantom_did_not() -> None:
    patient = load_scene("default", seed=1, fiducials=Carrier.SURFACE).head
    phantom = load_scene("default", seed=1, fiducials=Carrier.SURFACE, target_balls=True).head
    assert not patient.skin_shift.is_none
    places = np.array([target.entry_ct_mm for target in patient.targets])
    assert np.abs(skin_in_theatre(patient).distance_mm(places)).max() > 0.02
    assert skin_in_theatre(phantom).distance_mm(places) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    "change",
    [
        {"fiducials": []},
        {"skin_shift": {"pillow_mm": -1.0}},
        {"bare_bone": {"centre_ct_mm": [3.2, -41.7, 902.4], "radius_mm": 30.0}},
    ],
)
def test_a_head_without_a_face_needs_a_sphere_and_has_no_skin_to_move(change: dict[str, object]) -> None:
    content = draw_scene("mini").model_dump(by_alias=True, mode="json")
    content["head"] |= change
    with raises(BAD_SCENE, match="face"):
        parse_scene(content, "scene.json")


def test_a_shift_that_names_only_its_seed_is_none() -> None:
    assert SkinShift(seed=4, field_length_mm=20.0).is_none
    assert not SkinShift(offset_mm=0.1).is_none
