"""Home of the assistant in a drawn scene: it leaves the way of the master free."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.arm.catalogue import ArmChoice, find_arm
from ronna_hw.arm.clearance.arm_pair import PlacedArm
from ronna_hw.arm.clearance.bodies import Bodies, Surroundings, segment_distance_mm
from ronna_hw.arm.pose import Pose
from sim.world.rigid import apply, matrix_of
from sim.world.scene.assistant import add_assistant
from sim.world.scene.named_scenes import draw_scene

BETWEEN_THE_ARMS_MM = (0.0, -200.0, 400.0)  # from the middle of the head: there the master turns its frame
FREE_MM = 300.0  # around that place: the stereo head, turned about its frame, is as wide


@pytest.mark.parametrize("model", list(ArmChoice))
@pytest.mark.parametrize("master", [ArmChoice.KR6, ArmChoice.UR5E])
def test_at_home_an_assistant_of_any_model_leaves_the_master_room_to_turn_its_frame(
    master: ArmChoice, model: ArmChoice
) -> None:
    scene = add_assistant(draw_scene("mini", arm=master), model)
    assert scene.assistant is not None
    head_mm = apply(matrix_of(scene.head.robot_from_ct), scene.head.centre_ct_mm)
    x, y, z = (head_mm + BETWEEN_THE_ARMS_MM).tolist()
    bodies = Bodies(find_arm(scene.assistant.arm.variant).kinematics, Surroundings())
    base = Pose.from_matrix(matrix_of(scene.assistant.robot_from_base).tolist())
    arm = PlacedArm("assistant", bodies, base)
    (axes_mm,) = arm.axes(np.radians([scene.assistant.arm.home_deg])).tolist()
    free_mm = [
        segment_distance_mm((x, y, z), (x, y, z), tuple(start), tuple(end)) - radius_mm
        for (start, end), radius_mm in zip(axes_mm, arm.radii_mm, strict=True)
    ]
    assert min(free_mm) > FREE_MM
