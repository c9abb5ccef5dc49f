"""Surroundings for the arm's clearance check: the room, and the head where the case has located it."""

from __future__ import annotations

from numpy.typing import ArrayLike

from procedures.engine.context import StepContext
from procedures.planning.scene import PlanningScene
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.strategies.trajectory import Trajectory
from procedures.workcell import MountedTool
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

READS = (CheckedPlan, LocalizedFiducials)  # what every step that surrounds the arm must declare


def planning_scene_of(context: StepContext) -> PlanningScene:
    """Return the scene of a step: the head in the CT, its spheres, and the theatre file's bodies."""
    around = context.setting.surroundings
    return planning_scene(around, context.result(CheckedPlan), context.result(LocalizedFiducials))


def planning_scene(
    around: CollisionConfig, plan: CheckedPlan, localized: LocalizedFiducials
) -> PlanningScene:
    """Build the planning scene from the theatre file's bodies, the checked plan and the localized spheres."""
    return PlanningScene(
        around,
        plan.head,
        tuple(marker.centre_mm for marker in localized.markers),
        localized.bodies_on_head(plan.plan.fiducials),
    )


def surround_stereo_head(
    context: StepContext,
    near_rad: JointVector,
    trajectory: Trajectory | None = None,
    offset_mm: ArrayLike = (0.0, 0.0, 0.0),
) -> None:
    """Set the arm's surroundings from the coarse registration while the stereo head is mounted.

    `near_rad` is where the arm works, see `Workcell.surround`. With a trajectory, its corridor into the head
    is open. `offset_mm` (3,) is the displacement of the head as seen by the stereo head.
    """
    workcell = context.workcell
    robot_from_ct = context.result(Correspondence).robot_from_ct.transform.displace(offset_mm)
    tool = workcell.master.flange_from(MountedTool.STEREO_HEAD)
    workcell.master.surround(
        planning_scene_of(context).with_stereo_head(robot_from_ct, tool, trajectory), near_rad
    )


def surround_guide(context: StepContext, robot_from_ct: Transform, near_rad: JointVector) -> Surroundings:
    """Set the arm's surroundings from this trajectory's registration while the guide is mounted.

    `near_rad` is where the arm works, see `Workcell.surround`.
    """
    workcell = context.workcell
    trajectory = context.result(CheckedPlan).trajectory(context.trajectory).trajectory
    guide = workcell.master.flange_from(MountedTool.GUIDE)
    surroundings = planning_scene_of(context).with_guide(robot_from_ct, guide, trajectory)
    workcell.master.surround(surroundings, near_rad)
    return surroundings
