"""What the arm is told of its surroundings: head and cell, as far as the case knows where they are."""

from __future__ import annotations

from procedures.engine.step import StepContext
from procedures.planning.head_shape import HeadShape
from procedures.planning.planning_scene import PlanningScene
from procedures.steps.arm_frames import guide_in_flange, stereo_tool_in_flange
from procedures.steps.payloads import pose_from
from procedures.steps.plan_check import trajectory_of
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.readings import JointVector


def planning_scene_of(context: StepContext) -> PlanningScene:
    """The head as the CT shows it, the spheres on it, and the cell of the theatre file."""
    markers = context.case.get("fiducial_localization").payload["markers"]
    return PlanningScene(
        context.theatre.cell,
        HeadShape.from_payload(context.case.get("plan_check").payload["head"]),
        tuple((float(x), float(y), float(z)) for x, y, z in (marker["centre_mm"] for marker in markers)),
    )


def surround_stereo_head(context: StepContext) -> None:
    """Tell the arm what is around while the stereo head hangs on it, by the coarse registration."""
    robot_from_ct = pose_from(context.case.get("correspondence").payload["robot_from_ct"])
    tool = stereo_tool_in_flange(context)
    context.devices.arm.surround(planning_scene_of(context).with_stereo_head(robot_from_ct, tool))


def surround_guide(context: StepContext) -> None:
    """Tell the arm what is around while the guide hangs on it, by this trajectory's registration."""
    robot_from_ct = pose_from(context.result("registration").payload["robot_from_ct"])
    trajectory = trajectory_of(context).trajectory
    around = planning_scene_of(context).with_guide(robot_from_ct, guide_in_flange(context), trajectory)
    context.devices.arm.surround(around)


def move_clear(context: StepContext, target_rad: JointVector) -> None:
    """A joint move, by way of home where the straight one is not clear. Raises ARM-007 when neither is."""
    arm = context.devices.arm
    try:
        arm.move_joints(target_rad)
    except NotClear:  # raised before anything moved
        home: JointVector = tuple(context.case.get("set_up").payload["home_rad"])
        arm.move_joints(home)
        arm.move_joints(target_rad)
