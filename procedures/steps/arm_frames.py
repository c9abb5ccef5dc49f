"""Where the tools are as far as the controller knows: nominal kinematics and calibration records."""

from __future__ import annotations

from procedures.engine.step import StepContext
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Frame, Transform


def stereo_tool_in_flange(context: StepContext) -> Transform:
    """FLANGE <- TOOL of the stereo head, from its calibration record."""
    return context.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)


def guide_in_flange(context: StepContext) -> Transform:
    """FLANGE <- TOOL of the guide's tip, from its calibration record."""
    return context.calibrations.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)


def tool_pose(context: StepContext, joints_rad: JointVector, tool_in_flange: Transform) -> Transform:
    """Nominal pose ROBOT <- TOOL at measured joint angles."""
    return context.devices.arm.kinematics.flange_pose(joints_rad) @ tool_in_flange
