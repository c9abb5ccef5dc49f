"""The simulated arms of Universal Robots: the drivers' kinematics in other words, and errors of their own."""

from __future__ import annotations

from math import cos, pi

import numpy as np
import pytest

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm.universal_robots import UR5, UR5E, universal_robot
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS
from ronna_hw.vectors import joint_vector
from sim.polaris.measurement.line_of_sight import ArmBody
from sim.world.descriptions import DESCRIPTIONS
from sim.world.scene.arm_design import CHOSEN
from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import JointChain, TrueArm
from sim.world.universal_robots_arm import POSTURES, axes_of_branch
from sim.world.world import ArmState

NO_ERROR = (0.0,) * 6


@pytest.mark.parametrize("model", DIMENSIONS)
def test_the_simulated_arm_stands_where_the_driver_computes_it(model: str) -> None:
    generator = np.random.default_rng(1)
    chain, arm = JointChain(DESCRIPTIONS[model]), universal_robot(model)
    for joints in generator.uniform(-pi, pi, (200, 6)):
        pose = arm.forward(joint_vector(joints.tolist()))
        simulated = chain.flange(joints)
        assert simulated[:3, 3] == pytest.approx(pose.position_mm, abs=1e-9)
        assert simulated[:3, :3] == pytest.approx(np.reshape(pose.rotation, (3, 3)), abs=1e-12)


@pytest.mark.parametrize("model", DIMENSIONS)
def test_every_posture_is_among_its_poses_branches_and_each_leads_to_the_pose(model: str) -> None:
    generator = np.random.default_rng(4)
    arm, chain = DESCRIPTIONS[model], JointChain(DESCRIPTIONS[model])
    for joints in generator.uniform(-pi, pi, (50, 6)):
        flange = chain.flange(joints).copy()
        found = [axes for branch in range(8) if (axes := axes_of_branch(arm, flange, branch)) is not None]
        assert all(chain.flange(axes) == pytest.approx(flange, abs=1e-9) for axes in found)
        apart = (np.array(found) - joints + pi) % (2.0 * pi) - pi
        assert np.abs(apart).max(axis=1).min() < 1e-6


@pytest.mark.parametrize("arm", [ArmChoice.UR5, ArmChoice.UR5E])
def test_the_usual_posture_is_that_of_home(arm: ArmChoice) -> None:
    home, described = np.radians(CHOSEN[arm].home_deg), DESCRIPTIONS[CHOSEN[arm].variant]
    found = axes_of_branch(described, JointChain(described).flange(home).copy(), POSTURES[0])
    assert np.exp(1j * np.array(found)) == pytest.approx(np.exp(1j * home), abs=1e-9)


def sagging(model: str) -> ArmTruth:
    drawn = draw_arm(np.random.default_rng(2))
    link = {"translation_mm": (0.0, 0.0, 0.0), "rotation_rad": (0.0, 0.0, 0.0)}
    errors = ("joint_offset_rad", "harmonic_1_rad", "harmonic_2_rad", "backlash_rad")
    values = drawn.model_dump() | dict.fromkeys(errors, NO_ERROR)
    return ArmTruth(**values | {"variant": model, "links": (link,) * 6, "sag_rad": (1e-3, 1e-3)})


@pytest.mark.parametrize("model", [UR5, UR5E])
@pytest.mark.parametrize("lift", [0.0, -0.6, -2.4, pi, 0.7])
def test_gravity_lowers_the_wrist_on_either_side_of_the_base(model: str, lift: float) -> None:
    joints = (0.3, lift, 0.2, 0.0, 0.5, 0.1)
    nominal = JointChain(DESCRIPTIONS[model]).flange(joints).copy()
    sunk = TrueArm(sagging(model), seed=1).moving(joints, NO_ERROR)
    assert sunk[2, 3] < nominal[2, 3] - 0.05


@pytest.mark.parametrize("model", [UR5, UR5E])
def test_an_upright_arm_does_not_sag(model: str) -> None:
    joints = (0.3, -pi / 2, 0.0, 0.0, 0.5, 0.1)
    assert cos(joints[1]) == pytest.approx(0.0)
    nominal = JointChain(DESCRIPTIONS[model]).flange(joints).copy()
    assert TrueArm(sagging(model), seed=1).moving(joints, NO_ERROR) == pytest.approx(nominal, abs=1e-9)


@pytest.mark.parametrize("model", [UR5, UR5E])
def test_the_body_that_hides_things_is_where_the_driver_keeps_clear_of_things(model: str) -> None:
    scene = draw_scene("mini", seed=3)
    scene = scene.model_copy(update={"arm": scene.arm.model_copy(update={"variant": model})})
    joints = (0.4, -1.2, -1.4, 0.3, 0.9, -0.6)
    segments, flange = universal_robot(model).link_segments(joints)
    pose = np.vstack([np.c_[np.reshape(flange.rotation, (3, 3)), flange.position_mm], [0.0, 0.0, 0.0, 1.0]])
    capsules = ArmBody(scene).capsules(ArmState(joints, pose, 0, True), 0, np.eye(4))
    moving = segments[1:]  # the shoulder turns in its place
    assert capsules.starts_mm == pytest.approx(np.array([start for start, _ in moving]), abs=1e-6)
    assert capsules.ends_mm == pytest.approx(np.array([end for _, end in moving]), abs=1e-6)
