"""How the guide will be held at a target: as planned, or where a followed movement of the head takes it.

The guide turns with the head except about its own axis, and the arm holds it with other joints: some of what
spheres and target had in common then remains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.engine.context import StepContext
from procedures.journal.results import Numbers6
from procedures.planning.plan.guide_hold import held_trajectory
from procedures.planning.plan.model import PlannedTrajectory
from procedures.registration.target_prediction import OwnErrors, SharedErrors
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.strategies.target import refined_target_pose
from ronna_hw.frames import Transform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldGuide:
    """Orientation robot <- tool, joints, and the target (3,) mm, after the head has `turned` (3, 3)."""

    rotation: Array
    joints_rad: Numbers6
    tip_mm: Array
    turned: Array

    def before(self, source: SharedErrors | OwnErrors) -> SharedErrors | OwnErrors:
        """The source with its errors at the target turned back to the head as it was localized."""
        back = self.turned.T
        if isinstance(source, SharedErrors):
            return replace(source, at_target_mm=back @ source.at_target_mm)
        return replace(source, at_target_mm2=back @ source.at_target_mm2 @ back.T)


def held_guide(
    context: StepContext, planned: PlannedTrajectory, robot_from_ct: Transform, moved: Transform | None
) -> HeldGuide:
    """At a target by a registration from before the head `moved`, if it has. Raises ARM-001 to ARM-003."""
    path, tip_mm = context.result(CheckedPaths).targets[planned.id], robot_from_ct.apply(planned.target_mm)
    pose = path.tool_pose.transform
    if moved is None:
        return HeldGuide(pose.rotation_matrix, path.joints_rad, tip_mm, np.eye(3))
    workcell = context.workcell
    along = held_trajectory(context.result(CheckedPlan).plan, planned, workcell.tools.guide.bore)
    pose = refined_target_pose(pose, along, moved @ robot_from_ct)
    joints_rad = workcell.joints_at(pose, path.joints_rad, path.approach_signs)
    return HeldGuide(pose.rotation_matrix, joints_rad, moved.apply(tip_mm), moved.rotation_matrix)
