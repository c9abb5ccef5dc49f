"""Where the tools are as far as the controller knows: nominal kinematics and calibration records."""

from __future__ import annotations

from procedures.engine.devices import MASTER
from procedures.engine.step import StepContext
from ronna_hw.arm.kinematics import forward
from ronna_hw.arm.model import ArmModel, ArmVariant, arm_model
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Frame, Transform


def model_of(context: StepContext) -> ArmModel:
    """The arm model that the theatre file names for the master arm."""
    return arm_model(str(context.theatre.robot[MASTER].options.get("variant", ArmVariant.SIXX)))


def stereo_tool_in_flange(context: StepContext) -> Transform:
    """FLANGE <- TOOL of the stereo head, from its calibration record."""
    return context.calibrations.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)


def guide_in_flange(context: StepContext) -> Transform:
    """FLANGE <- TOOL of the guide's tip, from its calibration record."""
    return context.calibrations.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)


def tool_pose(context: StepContext, joints_rad: JointVector, tool_in_flange: Transform) -> Transform:
    """Nominal pose ROBOT <- TOOL at measured joint angles."""
    return forward(model_of(context), joints_rad).to_transform() @ tool_in_flange
