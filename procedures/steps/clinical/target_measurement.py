"""Application error on a phantom with a ball at each target, measured by the stereo head.

The arm goes to the target as with the guide, by the same registration and along the same axis. The centre of
the stereo head takes the place of the tip. The distance of the ball is the application error as the
thesis measured it. It needs no external truth, so it is the only method on hardware.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.journal.results import FramedPose, Matrix3, StepResult
from procedures.operator.question import Topic
from procedures.relocalization.errors import Saturated
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.positioning import name_refusals
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.room import ROOM_READS, check_room
from procedures.steps.clinical.surroundings import READS, surround_stereo_head
from procedures.steps.conditions import REMOUNTED, needs_tool
from procedures.strategies.trajectory import back_along_axis, refine_target_pose
from procedures.workcell import MountedTool
from procedures.workcell.stereo_look import Look, pair_picture
from ronna_hw.calibration import Numbers3
from ronna_hw.vectors import JointVector


class MeasuredTarget(StepResult, kind="target_measurement"):
    """Distance of the ball at a target from the stereo head's centre after positioning by the arm."""

    tool_pose: FramedPose = Field(
        description="Pose robot <- tool with its centre on the target, as commanded."
    )
    error_mm: float | None = Field(description="Distance of the ball; none if it was not measured.")
    ball_tool_mm: Numbers3 | None = Field(description="The ball in the tool frame; z is along the axis.")
    covariance_mm2: Matrix3 | None = Field(description="Covariance of this measurement alone, tool frame.")
    not_measured: str = Field(default="", description="Why there is no measurement.")
    joints_rad: JointVector = Field(description="Joints measured with the image pair.")


def run(context: StepContext) -> Outcome[MeasuredTarget]:
    """Bring the stereo head to the target, look, and back out. A ball out of view is recorded as such."""
    workcell, name = context.workcell, context.trajectory
    workcell.master.mount.check(MountedTool.STEREO_HEAD)
    paths = context.result(CheckedPaths)
    planned = context.result(CheckedPlan).trajectory(name).trajectory
    robot_from_ct = context.result(RegisteredRobot).robot_from_ct_at(name)
    target = refine_target_pose(paths.targets[name].tool_pose.transform, planned, robot_from_ct)
    travel_mm = planned.depth_mm + context.setting.settings.approach_mm
    approach_pose = back_along_axis(target, travel_mm)
    surround_stereo_head(context, paths.targets[name].joints_rad, planned)
    with name_refusals(name):
        approach_rad = workcell.master.joints_at(approach_pose, paths.targets[name].approach_rad)
        move_over = workcell.master.go_motion(approach_rad)
        line_onto = workcell.master.line_to_motion(target, paths.targets[name].sides, approach_rad)
        workcell.master.supervised.confirm(
            Topic.APPROACH,
            f"on a phantom with a ball at {name}: move the stereo head over it, then {travel_mm:.0f} mm "
            "along the axis until the ball is at its centre",
            [move_over, line_onto],
            name,
        )
    check_room(context, f"before the ball at {name} is measured")
    workcell.start(cameras=True)
    context.progress(0.0, f"moving over {name}")
    with name_refusals(name, workcell):
        workcell.master.go(approach_rad)
        workcell.master.line_to(target, paths.targets[name].sides)
    context.progress(0.5, f"measuring the ball at {name}")
    seen, why = _look(context)
    joints_rad = workcell.master.joints_rad()
    workcell.master.line_to(approach_pose)
    check_room(context, f"after the ball at {name} was measured")
    point = None if seen is None else seen.point
    if seen is not None:
        context.keep_picture(f"stereo-{name}-target.png", pair_picture(seen))
    ball_mm = None if point is None else np.asarray(point.position_mm, dtype=float)
    error_mm = None if ball_mm is None else float(np.linalg.norm(ball_mm))
    return Outcome(
        MeasuredTarget(
            tool_pose=FramedPose.of(target),
            error_mm=error_mm,
            ball_tool_mm=None if ball_mm is None else tuple(ball_mm.tolist()),
            covariance_mm2=None if point is None else point.covariance_mm2.tolist(),
            not_measured=why,
            joints_rad=joints_rad,
        ),
        summary=f"not measured: {why}" if error_mm is None else f"the ball is missed by {error_mm:.3f} mm",
    )


def _look(context: StepContext) -> tuple[Look | None, str]:
    """Look for the ball around the centre, then on the whole sensors; return the reason if not found."""
    workcell = context.workcell
    why = ""
    for whole in (False, True):
        if whole:
            workcell.sensors.read_whole()
        else:
            workcell.sensors.read_around_tool(context.setting.settings.servo_area_px)
        try:
            seen = workcell.look()
        except Saturated as problem:
            why = problem.summary
            continue
        if seen.point is not None:
            return seen, ""
        why = seen.reason
    return None, why


STEP = StepSpec(
    MeasuredTarget,
    "Measure a ball at the target with the stereo head",
    Phase.OPERATION,
    run,
    asks=(Topic.APPROACH,),
    scope=Scope.TRAJECTORY,
    reads=(RegisteredRobot, CheckedPaths, *ROOM_READS, *READS),
    moves=True,
    preconditions=needs_tool(MountedTool.STEREO_HEAD, REMOUNTED),
)
