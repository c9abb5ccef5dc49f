"""The tool at a target: its origin at rest, z along the trajectory, x set by the free angle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.strategies.orientation import require_frames, tool_orientation, tool_pose, turned_onto
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Frame, Transform


def target_pose(trajectory: Trajectory, robot_from_ct: Transform) -> Transform:
    """The pose ROBOT <- TOOL at the target. Raises FRM-001 on other frames than ROBOT <- CT."""
    return tool_pose(orientation_along(trajectory, robot_from_ct), robot_from_ct.apply(trajectory.rest_mm))


def refined_target_pose(planned: Transform, trajectory: Trajectory, robot_from_ct: Transform) -> Transform:
    """The pose at the target for a finer transform, given the `planned` pose of the coarse one.

    The smallest rotation turns the orientation onto the finer axis, so that no turn about the axis creeps in
    between localization and target. Raises FRM-001 on other frames.
    """
    require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
    require_frames(planned, Frame.ROBOT, Frame.TOOL)
    orientation = turned_onto(planned.rigid.rotation, _axis(trajectory, robot_from_ct))
    return tool_pose(orientation, robot_from_ct.apply(trajectory.rest_mm))


def poses_along(
    trajectory: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform
) -> tuple[Transform, ...]:
    """One pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, all in a trajectory's orientation."""
    orientation = orientation_along(trajectory, robot_from_ct)
    points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    return tuple(tool_pose(orientation, robot_from_ct.apply(point)) for point in points)


def orientation_along(trajectory: Trajectory, robot_from_ct: Transform) -> Rotation:
    """Rotation robot <- tool at the target of a trajectory. Raises FRM-001 on other frames."""
    require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
    target = robot_from_ct.apply(trajectory.target_mm)
    return tool_orientation(_axis(trajectory, robot_from_ct), target, trajectory.free_angle_rad)


def _axis(trajectory: Trajectory, robot_from_ct: Transform) -> NDArray[np.float64]:
    return np.asarray(robot_from_ct.rotation_matrix @ trajectory.axis_ct)
