"""The calibrated arm against the simulator's own, a chain in Pinocchio written independently."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from calibrated_ur import stated_kinematics

from ronna_hw.arm.catalogue import ArmChoice, find_arm
from ronna_hw.arm.clearance.bodies import Capsule, Corridor, Obstacle, Surroundings
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.kr6_r900 import SIXX, kr6_r900
from ronna_hw.arm.pose import Pose
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibrated_arm.deviations import ArmDeviations, flange_poses
from sim.theatre.arm_controllers import controller_of
from sim.theatre.records import arm_values
from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import ArmResidual, ArmTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.true_arm import TrueArm

KINEMATICS = kr6_r900(SIXX)
EXACT = ArmResidual(link_mm=0.0, angle_rad=0.0, tool_mm=0.0)
SAME_MM = 0.005  # of two chains whose joints are at other points of nearly the same axes
SAG_MISMATCH_MM = 0.06  # the lever of the wrist has the elbow's offset in it; the simulator's leaves it out


def _truth(variant: str = "kr6_r900_sixx", seed: int = 5) -> tuple[ArmTruth, ArmDeviations]:
    truth = draw_arm(np.random.default_rng(seed)).model_copy(update={"variant": variant})
    values = arm_values(truth, EXACT, np.random.default_rng(0))
    return truth, ArmDeviations(**{name: np.array(one) for name, one in values.items()})


def _postures(count: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.0, 1.0, (count, 6))


def test_without_deviations_the_chain_is_the_nominal_arm() -> None:
    poses = flange_poses(KINEMATICS.chain, ArmDeviations.none(6), _postures(20))
    for joints, pose in zip(_postures(20), poses, strict=True):
        np.testing.assert_allclose(pose, KINEMATICS.flange_pose(tuple(joints)).as_matrix(), atol=1e-9)


@pytest.mark.parametrize("variant", ["kr6_r900_sixx", "ur5e"])
def test_links_joints_harmonics_and_backlash_act_as_in_the_simulated_arm(variant: str) -> None:
    truth, deviations = _truth(variant)
    chain, true = find_arm(variant).kinematics.chain, TrueArm(truth, 5)
    flanks = np.sign(np.random.default_rng(2).normal(size=(50, 6)))
    ours = flange_poses(chain, deviations, _postures(50), flanks)
    theirs = [true.moving(joints, side) for joints, side in zip(_postures(50), flanks, strict=True)]
    assert np.abs(ours[:, :3, 3] - np.array(theirs)[:, :3, 3]).max() < SAG_MISMATCH_MM
    weightless = ArmDeviations(**{**vars(deviations), "sag_rad": np.zeros(6)})
    truth = truth.model_copy(update={"sag_rad": (0.0, 0.0)})
    ours = flange_poses(chain, weightless, _postures(50), flanks)
    theirs = [
        TrueArm(truth, 5).moving(joints, side) for joints, side in zip(_postures(50), flanks, strict=True)
    ]
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("kind", ["linearised", "exact", "none"])
@pytest.mark.parametrize("variant", ["ur5", pytest.param("ur5e", marks=pytest.mark.slow)])
def test_a_record_of_an_arm_whose_factory_measured_it_counts_no_deviation_twice(
    variant: str, kind: Literal["linearised", "exact", "none"]
) -> None:
    truth = draw_scene("mini", seed=3, arm=ArmChoice(variant)).arm.model_copy(update={"sag_rad": (0.0, 0.0)})
    stated = controller_of(truth).state_chain(truth, 3, (f"factory_calibration={kind}",))
    values = arm_values(truth, EXACT, np.random.default_rng(0), stated)
    record = ArmDeviations(**{name: np.array(one) for name, one in values.items()})
    kinematics = stated_kinematics(truth, 3, kind)
    true = TrueArm(truth, 3)
    theirs = np.array([true.moving(joints, (0.0,) * 6) for joints in _postures(50)])
    off_mm = {
        name: np.linalg.norm((poses - theirs)[:, :3, 3], axis=1).max()
        for name, poses in {
            "stated": flange_poses(kinematics.chain, ArmDeviations.none(6), _postures(50)),
            "with its record": flange_poses(kinematics.chain, record, _postures(50)),
        }.items()
    }
    assert off_mm["with its record"] < SAME_MM < 0.1 < off_mm["stated"]


def test_the_compensated_command_brings_the_flange_to_the_wanted_pose() -> None:
    _, deviations = _truth()
    arm = CalibratedArm(KINEMATICS, deviations)
    wanted = KINEMATICS.flange_pose(KINEMATICS.home_rad)
    found = arm.compensate(wanted, KINEMATICS.home_rad)
    assert arm.forward(found.joints_rad).distance_mm(Pose.from_transform(wanted)) < 1e-5
    assert KINEMATICS.forward(found.joints_rad).distance_mm(found.commanded) < 1e-6
    assert 0.5 < found.commanded.distance_mm(Pose.from_transform(wanted)) < 20.0


def test_without_a_record_joints_and_commanded_pose_are_exactly_the_nominal_ones() -> None:
    wanted = KINEMATICS.flange_pose(KINEMATICS.home_rad)
    found = CalibratedArm(KINEMATICS).compensate(wanted, KINEMATICS.home_rad)
    pose = Pose.from_transform(wanted)
    branch = KINEMATICS.branch_of(KINEMATICS.home_rad)
    assert found.commanded == pose
    assert found.joints_rad == KINEMATICS.solve_branch(pose, branch, KINEMATICS.home_rad)


def test_a_pose_out_of_reach_is_refused_as_by_the_nominal_arm() -> None:
    _, deviations = _truth()
    far = replace_position(KINEMATICS.forward(KINEMATICS.home_rad), (2000.0, 0.0, 500.0)).to_transform()
    with pytest.raises(Unreachable):
        CalibratedArm(KINEMATICS, deviations).compensate(far, KINEMATICS.home_rad)


def replace_position(pose: Pose, position_mm: tuple[float, float, float]) -> Pose:
    return pose._replace(position_mm=position_mm)


def test_the_surroundings_are_shifted_to_where_the_nominal_arm_of_the_controller_would_meet_them() -> None:
    _, deviations = _truth()
    arm, home = CalibratedArm(KINEMATICS, deviations), KINEMATICS.home_rad
    touched = arm.forward(home).position_mm
    room = Surroundings(
        obstacles=(Obstacle("ball", Capsule(touched, touched, 5.0)),),
        corridor=Corridor(touched, (touched[0], touched[1], touched[2] - 50.0), 6.0),
    )
    seen = arm.as_controller_sees(room, home)
    nominal = KINEMATICS.forward(home).position_mm
    assert seen.corridor is not None
    np.testing.assert_allclose(seen.obstacles[0].capsule.start_mm, nominal, atol=1e-9)
    np.testing.assert_allclose(seen.corridor.entry_mm, nominal, atol=1e-9)
    assert CalibratedArm(KINEMATICS).as_controller_sees(room, home) == replace(room)


@pytest.mark.parametrize("variant", ["kr6_r900_sixx", "ur5e"])
def test_one_posture_is_where_the_arrays_of_many_have_it(variant: str) -> None:
    kinematics, (_, deviations) = find_arm(variant).kinematics, _truth(variant)
    arm, draws = CalibratedArm(kinematics, deviations), np.random.default_rng(17)
    joints_rad, flanks = draws.uniform(-3.0, 3.0, (50, 6)), draws.choice([-1.0, 1.0], (50, 6))
    ours = [
        arm.flange_pose(tuple(one), sides).as_matrix() for one, sides in zip(joints_rad, flanks, strict=True)
    ]
    assert np.allclose(ours, flange_poses(kinematics.chain, deviations, joints_rad, flanks), atol=1e-9)
    for one in (arm, CalibratedArm(kinematics)):
        np.testing.assert_allclose(
            [pose.position_mm + pose.rotation for pose in one.forward_each(joints_rad)],
            [pose.position_mm + pose.rotation for pose in map(one.forward, map(tuple, joints_rad))],
            atol=1e-9,
        )
