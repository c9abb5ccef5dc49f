"""One strategy for a case, with others for some of its trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from procedures.strategies.arm_in_branch import ArmInBranch
from procedures.strategies.strategy import Strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Transform


@dataclass(frozen=True)
class StrategyByTrajectory:
    """`others` by trajectory name, `usual` for the rest; each trajectory is localized separately.

    For a strategy that otherwise localizes once, the poses serve that one trajectory.
    """

    usual: Strategy
    others: Mapping[str, Strategy]
    localizes_per_trajectory: bool = True

    @property
    def name(self) -> str:
        """Name of the usual strategy."""
        return self.usual.name

    @property
    def controls_approach(self) -> bool:
        """As the usual strategy does; see `of` for one trajectory."""
        return self.usual.controls_approach

    def of(self, trajectory: str) -> Strategy:
        """The strategy of one trajectory."""
        return self.others.get(trajectory, self.usual)

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """The axis of each trajectory's own strategy, under the name of the trajectory."""
        return tuple(
            replace(axis, identifier=one.identifier)
            for one in trajectories
            for axis in self.of(one.identifier).localized_along((one,), fiducials_mm, robot_from_ct)
        )

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Those of the trajectory's own strategy."""
        return self.of(along.identifier).localization_poses(along, fiducials_mm, robot_from_ct, arm)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> Sequence[float]:
        """Those of the trajectory's own strategy."""
        return self.of(along.identifier).turns_rad(along, fiducials_mm, robot_from_ct, arm)
