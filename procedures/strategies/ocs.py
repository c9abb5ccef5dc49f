"""OCS, orientation correction strategy: localize every fiducial in the orientation of the target pose.

A constant error of the tool frame then shifts all localizations and the target alike and cancels.
The price: the localizations are repeated for every trajectory, and all must be reachable in its orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.strategies.orientation import require_frames, tool_orientation, tool_pose, turned_onto
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Frame, Transform


@dataclass(frozen=True)
class OrientationCorrection:
    """The strategy `ocs`."""

    name: str = "ocs"
    localizes_per_trajectory: bool = True

    def localization_poses(
        self, trajectory: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Transform, ...]:
        """One pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, all in the target's orientation."""
        orientation = _orientation(trajectory, robot_from_ct)
        points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
        return tuple(tool_pose(orientation, robot_from_ct.apply(point)) for point in points)

    def target_pose(
        self, trajectory: Trajectory, robot_from_ct: Transform, *, localized_as: Transform | None = None
    ) -> Transform:
        """The pose ROBOT <- TOOL at the target. Raises FRM-001 on other frames than ROBOT <- CT.

        With `localized_as`, the orientation of the localizations is turned onto the refined axis by the
        smallest rotation, so that no angle about the axis creeps in between localization and target.
        """
        require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
        target = robot_from_ct.apply(trajectory.target_mm)
        if localized_as is None:
            return tool_pose(_orientation(trajectory, robot_from_ct), target)
        require_frames(localized_as, Frame.ROBOT, Frame.TOOL)
        return tool_pose(turned_onto(localized_as.rigid.rotation, _axis(trajectory, robot_from_ct)), target)


def _axis(trajectory: Trajectory, robot_from_ct: Transform) -> NDArray[np.float64]:
    return np.asarray(robot_from_ct.rotation_matrix @ trajectory.axis_ct)


def _orientation(trajectory: Trajectory, robot_from_ct: Transform) -> Rotation:
    require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
    target = robot_from_ct.apply(trajectory.target_mm)
    return tool_orientation(_axis(trajectory, robot_from_ct), target, trajectory.free_angle_rad)
