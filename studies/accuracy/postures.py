"""Nominal arm postures at every sphere and target, for one phantom position.

Joint ranges, reach and wrist singularity are checked as in a case; collisions and line of sight are not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.planning.free_angle import LEAST_BEND_RAD
from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Strategy, arrival_signs
from procedures.strategies.trajectory import Trajectory, target_pose
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from sim.world.scene.as_built import TOOL_IN_FLANGE_MM
from studies.accuracy.phantom import Phantom
from studies.accuracy.random_arms import PlannedPoses
from studies.errors import PHANTOM_OUT_OF_REACH

ARM: Kinematics = kr6_r900()
TOOL_MM = np.array(TOOL_IN_FLANGE_MM)
TOOL = Transform(Frame.FLANGE, Frame.TOOL, RigidTransform.from_components(TOOL_MM, Rotation.identity()))


@dataclass(frozen=True)
class Postures:
    """Planned postures for a strategy, with one localization set per target or a single shared one."""

    sets: int
    localizations: PlannedPoses  # sets * n
    targets: PlannedPoses  # t
    arrival: Array  # (sets * n, 6) side of its backlash on which each joint rests at a sphere, -1 or 1
    target_arrival: Array  # (t, 6)
    trajectories: tuple[Trajectory, ...]  # t, at their free angles

    def set_of(self, target: int) -> int:
        """Return the index of the localization set used for a target."""
        return target if self.sets > 1 else 0


def plan_postures(
    strategy: Strategy, phantom: Phantom, robot_from_ct: Transform, sizes: ErrorSizes = UNCALIBRATED
) -> Postures:
    """Plan all poses of a strategy; raises STU-010 if the arm cannot reach one."""
    arm = ArmInBranch(ARM, TOOL, TOOL, ARM.branch_of(ARM.home_rad), ARM.home_rad, sizes)
    localized = strategy.localized_along(phantom.trajectories, phantom.spheres_mm, robot_from_ct)
    is_per_trajectory = strategy.localizes_per_trajectory
    turned = [
        _best_turn(strategy, one, phantom, robot_from_ct, arm, with_target=is_per_trajectory)
        for one in localized
    ]
    if is_per_trajectory:
        targets = turned
    else:  # with the free angle of the localizations, as closely as the arm allows
        targets = [
            _nearest_turn(one, turned[0].free_angle_rad, robot_from_ct, arm) for one in phantom.trajectories
        ]
    looks = [
        pose
        for one in turned
        for pose in strategy.localization_poses(one, phantom.spheres_mm, robot_from_ct, arm)
    ]
    joints, arrival = _approach_joints(looks, arm)
    target_joints, target_arrival = _approach_joints(
        [target_pose(one, robot_from_ct) for one in targets], arm
    )
    if strategy.controls_approach:
        arrival = np.repeat(target_arrival, len(phantom.spheres_mm), axis=0)
    return Postures(
        sets=len(turned),
        localizations=PlannedPoses.of(ARM, TOOL_MM, joints),
        targets=PlannedPoses.of(ARM, TOOL_MM, target_joints),
        arrival=arrival,
        target_arrival=target_arrival,
        trajectories=tuple(targets),
    )


def plan_candidates(
    strategy: Strategy,
    trajectory: Trajectory,
    phantom: Phantom,
    robot_from_ct: Transform,
    sizes: ErrorSizes = UNCALIBRATED,
) -> Array | None:
    """Return a strategy's joints (n, 6) at all spheres for a trajectory as turned, or None out of reach."""
    arm = ArmInBranch(ARM, TOOL, TOOL, ARM.branch_of(ARM.home_rad), ARM.home_rad, sizes)
    try:
        poses = strategy.localization_poses(trajectory, phantom.spheres_mm, robot_from_ct, arm)
        joints = [arm.guide_joints(pose) for pose in poses]
    except (LimitError, NoNearbyJoints):
        return None
    is_bent = all(ARM.wrist_bend_rad(one) >= LEAST_BEND_RAD for one in joints)
    return np.array(joints) if is_bent else None


def _approach_joints(poses: list[Transform], arm: ArmInBranch) -> tuple[Array, Array]:
    """Return the joints (p, 6) for approaches along the tool axis, and each joint's backlash side."""
    joints = [arm.guide_joints(pose) for pose in poses]
    signs = [
        arrival_signs(ARM, pose, joint_vector, TOOL) for pose, joint_vector in zip(poses, joints, strict=True)
    ]
    return np.array(joints), np.array(signs, dtype=float)


def _best_turn(
    strategy: Strategy,
    along: Trajectory,
    phantom: Phantom,
    robot_from_ct: Transform,
    arm: ArmInBranch,
    *,
    with_target: bool,
) -> Trajectory:
    """Return the trajectory turned to the best free angle with all poses in reach."""
    for turn in strategy.turns_rad(along, phantom.spheres_mm, robot_from_ct, arm):
        turned = replace(along, free_angle_rad=along.free_angle_rad + turn)
        try:
            poses = strategy.localization_poses(turned, phantom.spheres_mm, robot_from_ct, arm)
            joints = [arm.guide_joints(pose) for pose in poses]
            if with_target:
                joints.append(arm.guide_joints(target_pose(turned, robot_from_ct)))
        except (LimitError, NoNearbyJoints):
            continue
        if all(ARM.wrist_bend_rad(one) >= LEAST_BEND_RAD for one in joints):
            return turned
    raise PHANTOM_OUT_OF_REACH(f"{strategy.name} does not reach all spheres for {along.identifier}")


def _nearest_turn(
    trajectory: Trajectory, free_angle_rad: float, robot_from_ct: Transform, arm: ArmInBranch
) -> Trajectory:
    """Return the trajectory turned to the reachable free angle nearest the desired one."""
    for turn in OUTWARDS_RAD:
        turned = replace(trajectory, free_angle_rad=free_angle_rad + turn)
        try:
            joints = arm.guide_joints(target_pose(turned, robot_from_ct))
        except LimitError:
            continue
        if ARM.wrist_bend_rad(joints) >= LEAST_BEND_RAD:
            return turned
    raise PHANTOM_OUT_OF_REACH(f"the arm does not reach the target of {trajectory.identifier}")
