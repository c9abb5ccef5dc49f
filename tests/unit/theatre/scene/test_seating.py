"""Where the spheres stand in the theatre, which is not quite where the CT saw them."""

import numpy as np
import pytest

from sim.theatre.scene.model import SEATING_ERROR_MM, Scene
from sim.theatre.scene.named_scenes import named_scene
from sim.theatre.scene.seating import spheres_in_theatre

SEEDS = 40


def beside_mm(scene: Scene) -> np.ndarray:
    """By how much each sphere (n, 3) stands beside its place in the CT."""
    there = np.array([one.centre_ct_mm for one in spheres_in_theatre(scene)])
    return np.asarray(there - [one.centre_ct_mm for one in scene.head.fiducials])


def with_head(scene: Scene, **changes: object) -> Scene:
    return scene.model_copy(update={"head": scene.head.model_copy(update=changes)})


def test_a_sphere_that_was_put_back_stands_a_twentieth_of_a_millimetre_beside_its_place() -> None:
    drawn = np.concatenate([beside_mm(named_scene("mini", seed=seed, markers=8)) for seed in range(SEEDS)])
    assert drawn.std(axis=0) == pytest.approx(3 * [SEATING_ERROR_MM], rel=0.15)
    assert np.abs(drawn.mean(axis=0)).max() < 4.0 * SEATING_ERROR_MM / len(drawn) ** 0.5


def test_without_seating_error_every_sphere_stands_where_the_ct_saw_it() -> None:
    assert not beside_mm(with_head(named_scene("mini"), seating_error_mm=0.0)).any()


def test_how_one_sphere_sits_does_not_depend_on_the_others() -> None:
    scene = named_scene("mini", markers=5)
    fewer = with_head(scene, fiducials=scene.head.fiducials[2:])
    assert beside_mm(fewer).tolist() == beside_mm(scene)[2:].tolist()
