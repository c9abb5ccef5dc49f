"""OCS, orientation correction strategy: localize every fiducial in the orientation of the target pose.

A constant tool frame error then shifts all localizations and the target alike and cancels. The cost: the
localizations are repeated for every trajectory, and all must be reachable in its orientation.

The thesis leaves open from which side each joint arrives, and mentions the backlash that remains. `ocs`
controls it; without that control it is the thesis' own (`thesis-ocs`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from procedures.strategies.arm_in_branch import ArmInBranch
from procedures.strategies.free_turns import OUTWARDS_RAD
from procedures.strategies.target import poses_along
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Transform


@dataclass(frozen=True)
class OrientationCorrection:
    """The strategy `ocs`, and `thesis-ocs`, which does not control the approach."""

    name: str = "ocs"
    controls_approach: bool = True
    localizes_per_trajectory: bool = True

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """The trajectories."""
        return tuple(trajectories)

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """One pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, all in the target's orientation."""
        return poses_along(along, fiducials_mm, robot_from_ct)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[float, ...]:
        """From the planned angle outwards: all serve equally well."""
        return OUTWARDS_RAD
