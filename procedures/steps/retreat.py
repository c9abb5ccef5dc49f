"""Retreat along the axis, and park after the last target."""

from __future__ import annotations

from procedures.engine.step import Outcome, StepContext, StepSpec
from procedures.steps.arm_frames import guide_in_flange
from procedures.steps.guide_path import standoff_pose
from procedures.steps.link_health import link_payload
from procedures.steps.payloads import pose_from
from procedures.steps.surroundings import surround_guide
from ronna_hw.devices.readings import JointVector


def run(context: StepContext) -> Outcome:
    """Back out along the trajectory; after the last one to the pose where the case began."""
    arm = context.devices.arm
    positioning = context.result("positioning")
    surround_guide(context)
    target = pose_from(positioning.payload["tool_pose"])
    reached = arm.move_linear(standoff_pose(context, target), flange_from_tool=guide_in_flange(context))
    last = context.key.trajectory == context.trajectories[-1]
    payload: dict[str, object] = {"parked": last}
    if last:
        home: JointVector = tuple(context.case.get("set_up").payload["home_rad"])
        reached = arm.move_joints(home)
        payload["link"] = link_payload(context)
        arm.deactivate()
    return Outcome(
        payload={**payload, "joints_rad": list(reached.joints_rad)},
        parents=(positioning,),
        summary="parked" if last else "outside the entry",
    )


STEP = StepSpec(
    "retreat",
    "Retreat along the axis",
    needs=("positioning", "at_target"),
    run=run,
    per_trajectory=True,
    moves=True,
)
