"""Where the ball is before the head has seen it: told by the operator, or seen by the tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import NoBall
from procedures.calibration.pose_set import PlannedLook
from procedures.engine.step import StepContext
from procedures.steps import global_localization
from procedures.steps.arm_frames import stereo_tool_in_flange, tool_pose
from procedures.steps.payloads import points_from
from procedures.strategies.orientation import tool_orientation
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

DOWN = np.array([0.0, 0.0, -1.0])
ALONE_MM = 30.0  # of a ball's nearest neighbour: nearer, both are in view
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class BallPlace:
    """Coarse place of the ball and of other balls (n, 3), mm in the robot frame."""

    ball_mm: Array
    others_mm: Array

    @property
    def reference(self) -> Rotation:
        """Orientation robot <- tool that looks straight down on the ball, mount turned outwards."""
        return tool_orientation(DOWN, self.ball_mm, 0.0)

    @property
    def first_look(self) -> PlannedLook:
        """The ball in the tool centre, looked at from above."""
        pose = Transform.of(
            Frame.ROBOT,
            Frame.TOOL,
            translation_mm=self.ball_mm,
            quaternion_wxyz=self.reference.as_quat(scalar_first=True),
        )
        return PlannedLook(pose, (0.0, 0.0, 0.0))


def place_of_ball(context: StepContext, told_mm: Triple | None) -> BallPlace:
    """The told place, or by the tracker the ball nearest to the head as it stands. Raises CAL-009.

    The arm rests, as the localization by the tracker wants it.
    """
    if told_mm is not None:
        return BallPlace(np.array(told_mm), np.empty((0, 3)))
    found = context.case.add("global_localization", global_localization.run(context).payload, ())
    points = points_from(found.payload["points_robot_mm"])
    alone = [number for number in range(len(points)) if _nearest_mm(points, number) >= ALONE_MM]
    if not alone:
        raise NoBall("the tracker sees no ball that stands alone", got=f"{len(points)} stray spheres")
    joints = context.devices.arm.read_state().joints_rad
    head_mm = tool_pose(context, joints, stereo_tool_in_flange(context)).translation_mm
    chosen = min(alone, key=lambda number: float(np.linalg.norm(points[number] - head_mm)))
    return BallPlace(points[chosen], np.delete(points, chosen, axis=0))


def _nearest_mm(points: Array, number: int) -> float:
    others = np.delete(points, number, axis=0)
    return float(np.linalg.norm(others - points[number], axis=1).min()) if len(others) else np.inf
