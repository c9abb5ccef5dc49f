"""How a pose is approached along the tool axis: its speed, and the direction in which each joint arrives.

Backlash shows on the side that the joint comes from. The same arrival direction at fiducials and target makes
it equal at all of them, so the registration removes it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from procedures.strategies.arm_in_branch import Joints
from procedures.strategies.orientation import back_along_axis
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Transform

ONE_SIDE = (1, 1, 1, 1, 1, 1)  # which it is does not matter, as long as it is the same
AXIAL_SPEED_FRACTION = 0.5  # of the working speed, on the way towards the skin
# How far each joint stands back before it turns onto a position: ten times the backlash of a worn gear.
APPROACH_RAD = math.radians(0.2)
LAST_STRETCH_MM = 5.0  # of the line to the pose: the direction each joint turns there decides its backlash


def arrival_signs(
    kinematics: Kinematics, pose: Transform, at_rad: Joints, flange_from_tool: Transform
) -> tuple[int, ...]:
    """Direction, +1 or -1, in which each joint arrives at a pose ROBOT <- TOOL with the joints `at_rad`."""
    before = back_along_axis(pose, LAST_STRETCH_MM) @ flange_from_tool.inverse()
    branch = kinematics.branch_of(at_rad)
    joints = kinematics.solve_branch(Pose.from_transform(before), branch, at_rad)
    return tuple(1 if after >= earlier else -1 for earlier, after in zip(joints, at_rad, strict=True))


def before_arriving(joints_rad: Joints, arriving: Sequence[int]) -> Joints:
    """Joints a little before a position, from which each then turns onto it in its direction, +1 or -1."""
    A = [joint - sign * APPROACH_RAD for joint, sign in zip(joints_rad, arriving, strict=True)]
    return (A[0], A[1], A[2], A[3], A[4], A[5])
