"""JDMS: at each fiducial the joints differ least from those at the target."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import ARM, FIDUCIALS, KR6, LEANING, ROOM

from procedures.calibration.arm_sources import ArmPoses, arm_sources
from procedures.registration.target_prediction import predict_target_error
from procedures.strategies.catalogue import BestOfEach, find_strategy
from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.joint_displacement import JointDisplacementMinimization, least_displacement
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch
from procedures.strategies.trajectory import Trajectory, target_pose
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, displacements
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

JDMS = JointDisplacementMinimization()
UR5 = universal_robot("ur5")
OFFSET_WRIST = ArmInBranch(
    UR5, ARM.flange_from_guide, ARM.flange_from_stereo, UR5.branch_of(UR5.home_rad), UR5.home_rad
)


def from_target_rad(arm: ArmInBranch, pose: Transform, at_target: JointVector) -> float:
    """Distance of the joints at a pose from those at the target."""
    flange = Pose.from_transform(pose @ arm.flange_from_stereo.inverse())
    return math.dist(arm.kinematics.solve_branch(flange, arm.branch, at_target), at_target)


def displacements_rad(trajectory: Trajectory, arm: ArmInBranch = ARM) -> list[float]:
    at_target = arm.guide_joints(target_pose(trajectory, ROOM))
    poses = JDMS.localization_poses(trajectory, FIDUCIALS, ROOM, arm)
    return [from_target_rad(arm, pose, at_target) for pose in poses]


@pytest.mark.parametrize("arm", [ARM, OFFSET_WRIST], ids=lambda arm: arm.kinematics.name)
def test_the_tool_is_at_every_fiducial(arm):
    for pose, fiducial in zip(JDMS.localization_poses(LEANING, FIDUCIALS, ROOM, arm), FIDUCIALS, strict=True):
        assert np.allclose(pose.translation_mm, ROOM.apply(fiducial), atol=1e-6)


@pytest.mark.slow
def test_no_other_orientation_needs_less_joint_motion():
    """A general optimizer over the three angles of the tool finds the same."""
    at_target = ARM.guide_joints(target_pose(LEANING, ROOM))
    for pose, found in zip(
        JDMS.localization_poses(LEANING, FIDUCIALS, ROOM, ARM), displacements_rad(LEANING), strict=True
    ):

        def displacement(turn, pose=pose):
            rotation = Rotation.from_rotvec(turn) * target_pose(LEANING, ROOM).rigid.rotation
            rigid = RigidTransform.from_components(pose.translation_mm, rotation)
            return from_target_rad(ARM, Transform(Frame.ROBOT, Frame.TOOL, rigid), at_target)

        best = minimize(displacement, np.zeros(3), method="Nelder-Mead", options={"xatol": 1e-7})
        assert found == pytest.approx(best.fun, rel=1e-5)


def test_the_free_angle_with_the_least_motion_comes_first():
    motions = [
        math.hypot(*displacements_rad(replace(LEANING, free_angle_rad=turn)))
        for turn in JDMS.turns_rad(LEANING, FIDUCIALS, ROOM, ARM)
    ]
    assert len(motions) > len(OUTWARDS_RAD) // 2
    assert motions == sorted(motions)


def test_a_target_out_of_reach_is_refused_and_no_turn_is_offered():
    below = Trajectory("T1", (0.0, 1900.0, 0.0), (0.0, 1800.0, 0.0))
    assert JDMS.turns_rad(below, FIDUCIALS, ROOM, ARM) == ()
    with pytest.raises(Unreachable, match="ARM-001"):
        JDMS.localization_poses(below, FIDUCIALS, ROOM, ARM)


def test_a_fiducial_that_no_joints_near_the_target_reach_is_refused():
    with pytest.raises(NoNearbyJoints, match=r"STR-004.*\(3000, 0, 0\) mm"):
        least_displacement(ARM.kinematics, [220.0, 0.0, 60.0], ARM.near_rad, [3000.0, 0.0, 0.0])


CALIBRATED = ErrorSizes(tool_mm=0.1, links=0.16)


def predicted_mm(name: str, sizes: ErrorSizes, along: Trajectory = LEANING) -> float:
    """Rms of what the arm's errors leave at the target; joints rest on the same side everywhere."""
    arm = replace(ARM, sizes=sizes)
    at_target = target_pose(along, ROOM)
    poses = find_strategy(name).localization_poses(along, FIDUCIALS, ROOM, arm)
    spheres, tip = ROOM.apply(FIDUCIALS), ROOM.apply(along.target_mm)
    looks = np.array([arm.stereo_joints(pose) for pose in poses])
    sources = arm_sources(
        arm.kinematics.chain,
        ArmPoses(looks, spheres, np.ones((len(looks), 6))),
        ArmPoses(np.array([arm.guide_joints(at_target)]), tip[None], np.ones((1, 6))),
        sizes,
    )
    return predict_target_error(spheres, tip, sources).rms_mm


@pytest.mark.parametrize("sizes", [ErrorSizes(), CALIBRATED], ids=["set S", "calibrated"])
def test_improved_jdms_predicts_less_error_than_jdms_and_ocs(sizes: ErrorSizes) -> None:
    assert predicted_mm("improved", sizes) < min(predicted_mm("jdms", sizes), predicted_mm("ocs", sizes))


@pytest.mark.parametrize("beyond_mm", [-90.0, 60.0], ids=["held back", "held in"])
def test_with_the_guide_held_elsewhere_on_the_axis_the_error_at_the_target_is_optimized(
    beyond_mm: float,
) -> None:
    with_rest, sizes = LEANING.with_rest(beyond_mm), ErrorSizes(tool_mm=0.0)
    arm = replace(ARM, sizes=sizes)
    at_target = np.array([arm.guide_joints(target_pose(with_rest, ROOM))])
    wanted = displacements(KR6.chain, at_target, ROOM.apply([with_rest.target_mm]), sizes)

    def unlike_mm(name: str) -> float:
        poses = find_strategy(name).localization_poses(with_rest, FIDUCIALS, ROOM, arm)
        looks = np.array([arm.stereo_joints(pose) for pose in poses])
        there = displacements(KR6.chain, looks, ROOM.apply(FIDUCIALS), sizes)
        links, joints = there.links_mm - wanted.links_mm, there.joints_mm - wanted.joints_mm
        return float(np.sqrt(np.sum(links**2) + np.sum(joints**2)))

    assert unlike_mm("improved") < min(unlike_mm("jdms"), unlike_mm("ocs"))


def test_with_only_a_tool_frame_error_the_orientation_is_that_of_the_target() -> None:
    arm = replace(ARM, sizes=ErrorSizes(tool_mm=2.0, links=0.0, joints=0.0, backlash=0.0))
    wanted = target_pose(LEANING, ROOM).rotation_matrix
    for pose, fiducial in zip(
        find_strategy("improved").localization_poses(LEANING, FIDUCIALS, ROOM, arm), FIDUCIALS, strict=True
    ):
        np.testing.assert_allclose(pose.rotation_matrix, wanted, atol=1e-4)
        np.testing.assert_allclose(pose.translation_mm, ROOM.apply(fiducial), atol=1e-6)


def test_best_localizes_with_the_strategy_chosen_for_each_trajectory() -> None:
    best = BestOfEach(others={LEANING.identifier: find_strategy("ocs")})
    other = replace(LEANING, identifier="T2")
    for along, name in ((LEANING, "ocs"), (other, "improved")):
        expected = find_strategy(name).localization_poses(along, FIDUCIALS, ROOM, ARM)
        for pose, wanted in zip(best.localization_poses(along, FIDUCIALS, ROOM, ARM), expected, strict=True):
            np.testing.assert_array_equal(pose.rotation_matrix, wanted.rotation_matrix)
