"""Strategies that keep the joints at fiducials near those at the target: JDMS, and an improved version.

JDMS (joint displacement minimization): at each fiducial, the orientation whose joints differ least from those
at the target. Joint and link errors are then nearly equal at both and cancel. The cost: the orientations
differ slightly, so a tool frame error does not cancel entirely. The thesis states neither norm nor weights.
We use the Euclidean norm of the six angles, and the free angle that minimises its root mean square over the
fiducials.

The improved JDMS also weighs how each joint turns the tool. It considers all known errors of the arm
together: links, offsets, harmonics, gravity, tool frame, each with its size. The orientation at each fiducial
makes their displacement of the tool as similar as possible to that at the target. The registration removes
the common part. With a poorly known tool frame the result is close to OCS, on a calibrated arm close to JDMS.
It minimises over the rotation w of the tool about the fiducial the sum over the errors k of

    |d_k(q(w)) - d_k(q_target)|^2,   d_k: displacement of the tool by one standard deviation of error k

by Gauss-Newton, starting from the JDMS orientation. At the target the displacement is that of the
instrument's tip, beyond the end of the guide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.strategies.errors import NoNearbyJoints
from procedures.strategies.strategy import OUTWARDS_RAD, ArmInBranch, Strategy
from procedures.strategies.trajectory import Trajectory, target_pose, tool_pose
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import displacements
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, joint_vector

CONVERGED_RAD = 1e-10  # change of a step; 0.1 nm at 1 m
MOST_STEPS = 60  # 6 to 15 are usual; more means no convergence

STEP_RAD = 1e-4  # of a numerical derivative
LARGEST_STEP_RAD = 0.2  # beyond it the errors are no longer linear in the rotation
SETTLED_RAD = 1e-3  # changes the error at the target by less than a micrometre
MOST_TURNS = 8  # four or five is usual


def least_displacement(
    kinematics: Kinematics, tool_origin_mm: ArrayLike, start_rad: JointVector, point_mm: ArrayLike
) -> JointVector:
    """Find the joints nearest to `start_rad` that bring the tool origin to a point (3,) mm, robot frame.

    `tool_origin_mm` (3,) is in the flange. Minimises |q - q0| subject to p(q) = point, by sequential
    linearization: with the Jacobian J of the tool origin, q <- q0 + pinv(J) (point - p(q) + J (q - q0)). At a
    fixed point q - q0 is in the row space of J, which is the Lagrange condition. Joint ranges are not
    checked. Raises STR-004 when no such joints are found near the start.
    """
    tool, point = np.asarray(tool_origin_mm, dtype=float), np.asarray(point_mm, dtype=float)
    start = np.asarray(start_rad)
    joints = start
    for _ in range(MOST_STEPS):
        position, jacobian = _tool_origin(kinematics, joint_vector(joints.tolist()), tool)
        wanted = point - position + jacobian @ (joints - start)
        try:
            next_joints = start + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T, wanted)
        except np.linalg.LinAlgError:
            break
        step = float(np.abs(next_joints - joints).max())
        joints = next_joints
        if step < CONVERGED_RAD:
            return joint_vector(joints.tolist())
        if not step < np.pi:  # also catches NaN
            break
    where = ", ".join(f"{value:.0f}" for value in point)
    raise NoNearbyJoints(f"no joint angles near those at the target bring the tool to ({where}) mm")


def _tool_origin(kinematics: Kinematics, joints_rad: JointVector, tool_mm: Array) -> tuple[Array, Array]:
    """Return the tool origin (3,) mm in the robot frame, and its Jacobian (3, n) mm per rad."""
    flange = kinematics.forward(joints_rad)
    arm = np.reshape(flange.rotation, (3, 3)) @ tool_mm
    jacobian = kinematics.jacobian(joints_rad)
    return np.add(flange.position_mm, arm), jacobian[:3] + np.cross(jacobian[3:], arm, axis=0)


@dataclass(frozen=True)
class JointDisplacementMinimization(Strategy):
    """Joint displacement minimization strategy, `jdms`."""

    name: str = "jdms"
    controls_approach: bool = True
    localizes_per_trajectory: bool = True

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return one pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, with the joints nearest the target's.

        Raises ARM-001 to ARM-003 when the target is out of reach in this branch, STR-004 when no nearby
        joints reach a fiducial.
        """
        _, at_fiducials = solve_joints(along, fiducials_mm, robot_from_ct, arm)
        return tuple(arm.stereo_pose(joints) for joints in at_fiducials)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """Rank turns by joint displacement, smallest first, omitting turns with unreachable poses."""
        ranked = []
        for turn in OUTWARDS_RAD:
            turned = replace(along, free_angle_rad=along.free_angle_rad + turn)
            try:
                at_target, at_fiducials = solve_joints(turned, fiducials_mm, robot_from_ct, arm)
            except (LimitError, NoNearbyJoints):
                continue
            ranked.append((sum(math.dist(at_target, one) ** 2 for one in at_fiducials), turn))
        return tuple(turn for _, turn in sorted(ranked, key=lambda one: one[0]))


def solve_joints(
    along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
) -> tuple[JointVector, tuple[JointVector, ...]]:
    """Return the joints at the target and at each fiducial, rad."""
    at_target = arm.guide_joints(target_pose(along, robot_from_ct))
    points = robot_from_ct.apply(np.asarray(fiducials_mm, dtype=float).reshape(-1, 3))
    return at_target, tuple(
        least_displacement(arm.kinematics, arm.flange_from_stereo.translation_mm, at_target, point)
        for point in points
    )


@dataclass(frozen=True)
class ImprovedDisplacementMinimization(JointDisplacementMinimization):
    """The strategy `improved`, which ranks turns about the axis like JDMS."""

    name: str = "improved"

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return one pose ROBOT <- TOOL per fiducial (n, 3) in CT mm. Raises the errors of JDMS."""
        at_target, at_fiducials = solve_joints(along, fiducials_mm, robot_from_ct, arm)
        wanted = _error_displacements(arm, [at_target], robot_from_ct.apply(along.target_mm))[0]
        return tuple(arm.stereo_pose(_find_nearest_joints(arm, start, wanted)) for start in at_fiducials)


def _find_nearest_joints(arm: ArmInBranch, start_rad: JointVector, wanted: Array) -> JointVector:
    """Find joints with the tool origin of `start_rad` and error displacements nearest to `wanted`."""
    pose = arm.stereo_pose(start_rad)
    place = pose.translation_mm
    try:
        turn, joints = pose.rigid.rotation, arm.stereo_joints(pose)
    except LimitError:
        return start_rad
    for _ in range(MOST_TURNS):
        try:
            steps = [
                arm.stereo_joints(tool_pose(Rotation.from_rotvec(way) * turn, place))
                for way in STEP_RAD * np.eye(3)
            ]
        except LimitError:
            break
        here, *beside = _error_displacements(arm, [joints, *steps], place)
        slopes = np.stack([(one - here) / STEP_RAD for one in beside], axis=1)
        way = np.linalg.lstsq(slopes, wanted - here, rcond=None)[0]
        size = float(np.linalg.norm(way))
        next_turn = Rotation.from_rotvec(way * min(1.0, LARGEST_STEP_RAD / max(size, SETTLED_RAD))) * turn
        try:
            joints = arm.stereo_joints(tool_pose(next_turn, place))
        except LimitError:
            break
        turn = next_turn
        if size < SETTLED_RAD:
            break
    return joints


def _error_displacements(arm: ArmInBranch, joints_rad: list[JointVector], place_mm: Array) -> Array:
    """Return displacements (p, 3 k) mm of a tool point (3,) mm due to one sigma of each error."""
    places = np.tile(place_mm, (len(joints_rad), 1))
    rotations = np.array([arm.stereo_pose(joints).rotation_matrix for joints in joints_rad])
    moved = displacements(arm.kinematics.chain, np.array(joints_rad), places, arm.sizes)
    tool = arm.sizes.tool_mm * rotations
    return np.concatenate([moved.links_mm, moved.joints_mm, tool], axis=2).reshape(len(joints_rad), -1)
