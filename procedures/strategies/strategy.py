"""What a localization strategy decides: how often fiducials are localized, and in which tool orientations.

All strategies hold the tool the same way at a target, see `target_pose`: its axis is the trajectory's, and
only the free angle about it is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from numpy.typing import ArrayLike

from procedures.strategies.arm_in_branch import ArmInBranch
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Transform


class Strategy(Protocol):
    """Chooses tool orientations. Poses are ROBOT <- TOOL, from the coarse transform; nothing is kept."""

    @property
    def name(self) -> str:
        """The name used on the command line."""
        ...

    @property
    def localizes_per_trajectory(self) -> bool:
        """Whether every trajectory has its own localizations and registration, or one set serves all."""
        ...

    @property
    def controls_approach(self) -> bool:
        """Whether each joint arrives at a fiducial as it will at the target, see `arrival_signs`.

        Backlash is then equal at both. Only for strategies that localize per trajectory.
        """
        ...

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """The axes along which all fiducials (n, 3) in CT mm are localized, one set of poses for each.

        The trajectories themselves, or one axis that is independent of them.
        """
        ...

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """One pose per fiducial (n, 3) in CT mm, tool origin at the fiducial.

        Raises FRM-001 on other frames; a strategy that considers joints also raises ARM-001
        to ARM-003, STR-004.
        """
        ...

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> Sequence[float]:
        """Turns about the axis, best first, to add to the trajectory's free angle."""
        ...
