"""Spheres and posts that leave the area of interest must not stop a camera."""

import numpy as np
import pytest

from sim.basler.camera.photographer import Photographer
from sim.basler.camera.settings import Settings
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.named_scenes import named_scene
from sim.world.world import ArmState, World


@pytest.mark.parametrize("seed", range(6))
def test_a_picture_is_rendered_wherever_the_head_is_over_a_sphere(seed: int) -> None:
    scene = named_scene("default", seed=seed)
    world = World.create(scene, paced=False)
    photographer = Photographer(world, scene.left)
    generator = np.random.default_rng(seed)
    centre = apply(matrix_of(scene.head.robot_from_ct), spheres_in_theatre(scene)[0].centre_ct_mm)
    frame = Settings().frame()
    for number in range(12):
        axis = generator.normal(0.0, 0.4, 3) - (0.0, 0.0, 1.0)
        tool = matrix_from(centre + generator.normal(0.0, 12.0, 3), rotation_towards(axis, (1.0, 0.0, 0.0)))
        flange = tool @ inverse(matrix_of(scene.mount.flange_from_tool_true))
        world.publish_arm(ArmState((0.0,) * 6, flange, 1, True))
        image = photographer.triggered(frame, number)
        assert len(image) == frame.payload_bytes
