"""The guide's way to a target: over the entry, down the axis, and back. Shared by the steps that go it."""

from __future__ import annotations

from procedures.engine.step import StepContext
from procedures.steps.payloads import pose_from
from procedures.steps.plan_check import trajectory_of
from procedures.strategies.catalogue import strategy_named
from procedures.strategies.orientation import back_along_axis
from ronna_hw.frames import Transform


def target_pose(context: StepContext) -> Transform:
    """ROBOT <- TOOL with the guide's tip on the target, by this trajectory's registration."""
    registration = context.result("registration")
    path_check = context.case.get("path_check")
    localizations = path_check.payload["localizations"][str(context.key.trajectory)]
    strategy = strategy_named(str(path_check.payload["strategy"]))
    return strategy.target_pose(
        trajectory_of(context).trajectory,
        pose_from(registration.payload["robot_from_ct"]),
        localized_as=pose_from(localizations[0]["tool_pose"]),
    )


def standoff_pose(context: StepContext, target: Transform) -> Transform:
    """The pose on the axis outside the entry, by the theatre's stand-off."""
    depth_mm = trajectory_of(context).depth_mm
    return back_along_axis(target, depth_mm + context.theatre.procedure.standoff_mm)
