"""The plan of a motion as passed to a device: frames checked once, its speed applied, then plain floats."""

from __future__ import annotations

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.motion import JointMove, Motion
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Frame, FrameMismatch, Transform


def plan_motion(
    kinematics: Kinematics, start_rad: JointVector, motion: Motion, limits: MotionLimits
) -> MotionPlan:
    """Plan a motion from `start_rad` at its fraction of the limits.

    Raises FRM-001 for a line between other frames, ARM-006 for an invalid fraction, and the errors of
    `plan_joint_move` and `plan_line`.
    """
    slowed = limits.slowed(motion.speed_fraction)
    if isinstance(motion, JointMove):
        return plan_joint_move(kinematics, start_rad, motion.target_rad, slowed)
    tool = motion.flange_from_tool
    if tool is None:
        return plan_line(kinematics, start_rad, Pose.from_transform(motion.target), slowed)
    flange = Pose.from_transform(motion.target @ _tool_in_flange(tool).inverse())
    x, y, z = tool.translation_mm.tolist()
    return plan_line(kinematics, start_rad, flange, slowed, (x, y, z))


def _tool_in_flange(flange_from_tool: Transform) -> Transform:
    """The same transform; raises FRM-001 unless it is FLANGE <- TOOL."""
    if (flange_from_tool.target, flange_from_tool.source) != (Frame.FLANGE, Frame.TOOL):
        raise FrameMismatch(
            "a tool needs flange <- tool", got=f"{flange_from_tool.target} <- {flange_from_tool.source}"
        )
    return flange_from_tool
