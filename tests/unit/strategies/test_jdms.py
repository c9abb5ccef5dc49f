"""JDMS: at each fiducial the joints differ least from those at the target."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform, Rotation
from strategy_arms import ARM, FIDUCIALS, LEANING, ROOM
from ur5 import Ur5

from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.joint_displacement import JointDisplacementMinimization, least_displacement
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Joints
from procedures.strategies.trajectory import Trajectory, target_pose
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Frame, Transform

JDMS = JointDisplacementMinimization()
OFFSET_WRIST = ArmInBranch(
    Ur5(), ARM.flange_from_guide, ARM.flange_from_stereo, Ur5().branch_of(Ur5().home_rad), Ur5().home_rad
)


def from_target_rad(arm: ArmInBranch, pose: Transform, at_target: Joints) -> float:
    """Distance of the joints at a pose from those at the target."""
    flange = Pose.from_transform(pose @ arm.flange_from_stereo.inverse())
    return math.dist(arm.kinematics.solve_branch(flange, arm.branch, at_target), at_target)


def displacements_rad(trajectory: Trajectory, arm: ArmInBranch = ARM) -> list[float]:
    at_target = arm.guide_at(target_pose(trajectory, ROOM))
    poses = JDMS.localization_poses(trajectory, FIDUCIALS, ROOM, arm)
    return [from_target_rad(arm, pose, at_target) for pose in poses]


@pytest.mark.parametrize("arm", [ARM, OFFSET_WRIST], ids=lambda arm: arm.kinematics.name)
def test_the_tool_is_at_every_fiducial(arm):
    for pose, fiducial in zip(JDMS.localization_poses(LEANING, FIDUCIALS, ROOM, arm), FIDUCIALS, strict=True):
        assert np.allclose(pose.translation_mm, ROOM.apply(fiducial), atol=1e-6)


def test_no_other_orientation_needs_less_joint_motion():
    """A general optimizer over the three angles of the tool finds the same."""
    at_target = ARM.guide_at(target_pose(LEANING, ROOM))
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
