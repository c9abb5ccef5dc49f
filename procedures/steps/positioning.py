"""Carry the guide to a target: a joint move to the stand-off, then a straight line along the axis."""

from __future__ import annotations

from procedures.engine.errors import WrongTool
from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.steps.arm_frames import guide_in_flange
from procedures.steps.guide_path import standoff_pose, target_pose
from procedures.steps.payloads import pose_payload
from procedures.steps.surroundings import move_clear, surround_guide
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import JointVector

AXIAL_SPEED_FRACTION = 0.5  # of the working speed, on the way into the head


def run(context: StepContext) -> Outcome:
    """Move the tip of the guide onto the target; the tool is read again right before."""
    arm, tool = context.devices.arm, context.calibrations.tool_tip
    mounted = arm.read_tool_identity().number
    if mounted != tool.tool_number:
        raise WrongTool("the guide is not mounted", expected=str(tool.tool_number), got=str(mounted))
    target = target_pose(context)
    standoff = standoff_pose(context, target)
    context.confirm(
        f"move to {context.key.trajectory}",
        f"tool {mounted}, {context.theatre.procedure.standoff_mm:g} mm over the entry, then along the axis",
    )
    surround_guide(context)
    if arm.state is Lifecycle.CONFIGURED:
        arm.activate()
    path = context.case.get("path_check").payload["targets"][str(context.key.trajectory)]
    near: JointVector = tuple(path["standoff_rad"])
    kinematics = arm.kinematics
    flange = Pose.from_transform(standoff @ guide_in_flange(context).inverse())
    context.progress(0.0, f"moving over {context.key.trajectory}")
    move_clear(context, kinematics.solve_branch(flange, kinematics.branch_of(near), near))
    context.progress(0.5, f"moving along {context.key.trajectory}")
    reached = arm.move_linear(
        target,
        flange_from_tool=guide_in_flange(context),
        speed_fraction=AXIAL_SPEED_FRACTION,
    )
    return Outcome(
        payload={"tool_pose": pose_payload(target), "joints_rad": list(reached.joints_rad)},
        parents=(context.result("registration"), context.case.get("tool_change")),
        summary="the guide is on its axis",
    )


STEP = StepSpec(
    "positioning",
    "Carry the guide to the target",
    needs=("registration", "tool_change", "path_check"),
    run=run,
    per_trajectory=True,
    moves=True,
)
