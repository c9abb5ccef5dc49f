"""The improved JDMS: at each fiducial the arm errs as nearly as possible as it will at the target.

JDMS keeps the joints near those at the target, regardless of how each joint turns the tool, at the cost of
the tool frame's error. Here the orientation at each fiducial makes the displacement of the tool by all known
errors of the arm together (links, offsets, harmonics, gravity, tool frame; each with its size) as similar as
possible to that at the target. The registration removes the common part. With a poorly known tool frame the
result is close to OCS, on a calibrated arm close to JDMS.

Minimise over the rotation w of the tool about the fiducial the sum over the errors k of

    |d_k(q(w)) - d_k(q_target)|^2,   d_k: displacement of the tool by one standard deviation of error k

by Gauss-Newton, starting from the JDMS orientation. At the target the displacement is that of the
instrument's tip, beyond the end of the guide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.arm_sources import displacements
from procedures.strategies.arm_in_branch import ArmInBranch, Joints
from procedures.strategies.jdms import JointDisplacementMinimization, joints_of
from procedures.strategies.orientation import tool_pose
from procedures.strategies.trajectory import Trajectory
from ronna_hw.errors import LimitError
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

STEP_RAD = 1e-4  # of a numerical derivative
LARGEST_STEP_RAD = 0.2  # beyond it the errors are no longer linear in the rotation
SETTLED_RAD = 1e-3  # changes the error at the target by less than a micrometre
MOST_STEPS = 8  # four or five is usual


@dataclass(frozen=True)
class ImprovedDisplacementMinimization(JointDisplacementMinimization):
    """The strategy `improved`; turns about the axis are ranked as in JDMS."""

    name: str = "improved"

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """One pose ROBOT <- TOOL per fiducial (n, 3) in CT mm; raises like JDMS."""
        at_target, at_fiducials = joints_of(along, fiducials_mm, robot_from_ct, arm)
        wanted = _errors(arm, [at_target], robot_from_ct.apply(along.target_mm))[0]
        return tuple(arm.stereo_pose(_nearest(arm, start, wanted)) for start in at_fiducials)


def _nearest(arm: ArmInBranch, start_rad: Joints, wanted: Array) -> Joints:
    """Joints that keep the tool origin of `start_rad`, in the orientation with errors nearest `wanted`."""
    pose = arm.stereo_pose(start_rad)
    place = pose.translation_mm
    try:
        turn, joints = pose.rigid.rotation, arm.stereo_at(pose)
    except LimitError:
        return start_rad
    for _ in range(MOST_STEPS):
        try:
            steps = [
                arm.stereo_at(tool_pose(Rotation.from_rotvec(way) * turn, place))
                for way in STEP_RAD * np.eye(3)
            ]
        except LimitError:
            break
        here, *beside = _errors(arm, [joints, *steps], place)
        slopes = np.stack([(one - here) / STEP_RAD for one in beside], axis=1)
        way = np.linalg.lstsq(slopes, wanted - here, rcond=None)[0]
        size = float(np.linalg.norm(way))
        further = Rotation.from_rotvec(way * min(1.0, LARGEST_STEP_RAD / max(size, SETTLED_RAD))) * turn
        try:
            joints = arm.stereo_at(tool_pose(further, place))
        except LimitError:
            break
        turn = further
        if size < SETTLED_RAD:
            break
    return joints


def _errors(arm: ArmInBranch, joints_rad: list[Joints], place_mm: Array) -> Array:
    """Displacement of a point (3,) mm in the tool by one standard deviation of each error, (p, 3 k) mm."""
    places = np.tile(place_mm, (len(joints_rad), 1))
    rotations = np.array([arm.stereo_pose(joints).rotation_matrix for joints in joints_rad])
    moved = displacements(arm.kinematics.chain, np.array(joints_rad), places, arm.sizes)
    tool = arm.sizes.tool_mm * rotations
    return np.concatenate([moved.links_mm, moved.joints_mm, tool], axis=2).reshape(len(joints_rad), -1)
