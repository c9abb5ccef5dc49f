"""Drawn heads with a face leave room for the guide on every line, by the planner's bodies and its limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from procedures.planning.faced_head import face_bodies, fit_cranium_and_face
from procedures.planning.free_angle import choose_free_angles
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.scene import PlanningScene
from procedures.planning.visits import ArmSetting
from procedures.strategies.skin_looks import SkinLooks
from procedures.strategies.trajectory import Trajectory
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.pose import radians6
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Frame
from sim.world.head_surface.covering import cover_head
from sim.world.options import Carrier
from sim.world.rigid import apply, inverse, matrix_of
from sim.world.scene.guide_clearance import GuideClearance
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.scene.parts import Guide
from sim.world.scene.plan_feasibility import STANDOFF_MM
from sim.world.scene.skin import head_with_face
from studies.surface.heads import HeadInCt

# Seeds of long, narrow heads with prominent brows, over which the guide once came too close
ONCE_TOO_CLOSE = (34856, 5108, 19)
ALIKE_MM = 1.5  # ellipsoid around the cranium, drawn and found: its samples are others


def found_in_ct(scene: Scene) -> HeadInCt:
    head = head_with_face(scene.head)
    assert head is not None
    return HeadInCt.sample(head)


def judge(scene: Scene) -> tuple[object, ...]:
    """Objections of the planner to the drawn trajectories, by the head that it would find in the CT."""
    arm = find_arm(scene.arm.variant).kinematics
    cranium, face = fit_cranium_and_face(found_in_ct(scene))
    setting = ArmSetting(
        arm,
        scene.head.robot_from_ct.transform(Frame.ROBOT, Frame.CT),
        scene.mount.flange_from_tool_nominal.transform(Frame.FLANGE, Frame.TOOL),
        SkinLooks(),
        start_rad=radians6(*scene.arm.home_deg),
        limits=working_limits(arm),
        scene=PlanningScene(CollisionConfig(), cranium, (), face_bodies(face)),
    )
    left, right = (inverse(matrix_of(camera.camera_from_tool))[:3, 3] for camera in (scene.left, scene.right))
    trajectories = [
        Trajectory(one.identifier, one.entry_ct_mm, one.target_ct_mm).with_rest(
            Guide().reach_mm - STANDOFF_MM - one.depth_mm, STANDOFF_MM
        )
        for one in scene.head.targets
    ]
    found = choose_free_angles(setting, trajectories, np.empty((0, 3)), StereoSight(left, right))
    return found.check.unmet


@pytest.mark.parametrize("seed", [0, *ONCE_TOO_CLOSE])
def test_the_planner_accepts_what_is_drawn_on_the_skin(seed: int) -> None:
    assert judge(draw_scene("default", seed=seed, fiducials=Carrier.SURFACE, targets=5)) == ()


def test_without_the_clearance_the_planner_refuses_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(GuideClearance, "is_clear", lambda *_: True)
    refused = judge(draw_scene("default", seed=ONCE_TOO_CLOSE[0], fiducials=Carrier.SURFACE, targets=5))
    assert "end of the guide comes within" in str(refused)


def test_a_scene_whose_lines_were_clear_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = draw_scene("default", seed=0, fiducials=Carrier.MIXED, targets=5)
    monkeypatch.setattr(GuideClearance, "is_clear", lambda *_: True)
    assert drawn == draw_scene("default", seed=0, fiducials=Carrier.MIXED, targets=5)


@pytest.mark.parametrize("seed", ONCE_TOO_CLOSE)
def test_the_cranium_is_covered_as_the_planner_covers_it(seed: int) -> None:
    scene = draw_scene("mini", seed=seed, fiducials=Carrier.SURFACE)
    head = head_with_face(scene.head)
    assert head is not None
    drawn, _ = cover_head(head)
    found, _ = fit_cranium_and_face(found_in_ct(scene))
    for side in (-1.0, 1.0):
        ends = [np.add(one.centre_mm, np.multiply(side, one.semi_axes_mm)) for one in (drawn, found)]
        assert ends[0] == pytest.approx(ends[1], abs=ALIKE_MM)


def test_the_guide_is_too_close_where_it_is_held_lower() -> None:
    scene = draw_scene("default", seed=0, fiducials=Carrier.SURFACE)
    place = matrix_of(scene.head.robot_from_ct)
    head = head_with_face(scene.head)
    assert head is not None
    clearance = GuideClearance(head, place, np.empty((0, 3)))
    entry, target = (
        apply(place, one) for one in (scene.head.targets[0].entry_ct_mm, scene.head.targets[0].target_ct_mm)
    )
    axis = (target - entry) / math.dist(target, entry)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    orientation = np.column_stack([across, np.cross(axis, across), axis])
    held = entry + (Guide().reach_mm - STANDOFF_MM) * axis
    assert clearance.is_clear(orientation, held, 60.0)
    assert not clearance.is_clear(orientation, held + 20.0 * axis, 60.0)
    lower_mm = clearance.least_mm(orientation, held + 5.0 * axis, 60.0)
    assert 3.0 < clearance.least_mm(orientation, held, 60.0) - lower_mm < 5.1
