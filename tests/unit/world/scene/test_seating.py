"""Where the spheres are in the theatre, which is not exactly where the CT shows them."""

import numpy as np
import pytest

from sim.world.displacements import spheres_in_theatre
from sim.world.scene.model import SEATING_ERROR_MM, Scene
from sim.world.scene.named_scenes import named_scene

SEEDS = 40


def beside_mm(scene: Scene) -> np.ndarray:
    """By how much each sphere (n, 3) stands beside its place in the CT."""
    there = np.array([one.centre_ct_mm for one in spheres_in_theatre(scene)])
    return np.asarray(there - [one.centre_ct_mm for one in scene.head.fiducials])


def with_head(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"head": scene.head.model_copy(update=changes)})


def test_a_reseated_sphere_is_off_its_place_by_the_seating_error() -> None:
    scene = named_scene("mini", markers=8)
    drawn = np.concatenate([beside_mm(scene.model_copy(update={"seed": seed})) for seed in range(SEEDS)])
    assert drawn.std(axis=0) == pytest.approx(3 * [SEATING_ERROR_MM], rel=0.15)
    assert np.abs(drawn.mean(axis=0)).max() < 4.0 * SEATING_ERROR_MM / len(drawn) ** 0.5


def test_without_seating_error_every_sphere_is_where_the_ct_shows_it() -> None:
    assert not beside_mm(with_head(named_scene("mini"), seating_error_mm=0.0)).any()


def test_the_seating_of_a_sphere_does_not_depend_on_the_others() -> None:
    scene = named_scene("mini", markers=5)
    fewer = with_head(scene, fiducials=scene.head.fiducials[2:])
    assert beside_mm(fewer).tolist() == beside_mm(scene)[2:].tolist()


def test_a_sphere_may_be_missing_displaced_or_on_the_base_of_another() -> None:
    scene = with_head(named_scene("mini", markers=5), seating_error_mm=0.0)
    first, second, third, *others = scene.head.fiducials
    changed = (
        first.model_copy(update={"missing": True}),
        second.model_copy(update={"base_in_theatre": third.number, "displaced_mm": (0.0, 1.0, 0.0)}),
        third.model_copy(update={"base_in_theatre": second.number, "base_mm": 20.0, "worn_percent": 30.0}),
        *others,
    )
    two, three, *rest = spheres_in_theatre(with_head(scene, fiducials=changed))
    longer = 4.0 * np.array(second.post_ct) + (0.0, 1.0, 0.0)
    assert np.subtract(two.centre_ct_mm, second.centre_ct_mm) == pytest.approx(longer)
    shorter = -4.0 * np.array(third.post_ct)
    assert np.subtract(three.centre_ct_mm, third.centre_ct_mm) == pytest.approx(shorter)
    assert (two.worn_percent, three.worn_percent) == (30.0, 0.0)  # a film goes with its base
    assert rest == list(others)
