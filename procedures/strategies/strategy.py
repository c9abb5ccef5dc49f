"""What a localization strategy answers: how the tool is held at every fiducial, and at the target."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import ArrayLike

from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Transform


class Strategy(Protocol):
    """Chooses tool orientations. All poses are ROBOT <- TOOL.

    `localizes_per_trajectory` says whether the fiducials are measured again for every trajectory (and each
    trajectory has a registration of its own), or once for all.
    """

    @property
    def name(self) -> str:
        """The name on the command line."""
        ...

    @property
    def localizes_per_trajectory(self) -> bool:
        """Whether every trajectory has localizations and a registration of its own."""
        ...

    def localization_poses(
        self, trajectory: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Transform, ...]:
        """One pose per fiducial (n, 3) in CT mm, tool origin at the fiducial, from the coarse transform."""
        ...

    def target_pose(
        self, trajectory: Trajectory, robot_from_ct: Transform, *, localized_as: Transform | None = None
    ) -> Transform:
        """The pose at the target: tool origin at the target, tool z along the trajectory.

        With the fine transform, `localized_as` is a pose of the localizations: the angle about the axis is
        then taken over from it.
        """
        ...
