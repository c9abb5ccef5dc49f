"""All strategies by name, and combinations of them: one per trajectory, or the best for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from numpy.typing import ArrayLike

from procedures.strategies.errors import UNKNOWN_STRATEGY
from procedures.strategies.fixed_orientation import (
    LearningStrategy,
    NeutralOrientation,
    OrientationCorrection,
)
from procedures.strategies.joint_displacement import (
    ImprovedDisplacementMinimization,
    JointDisplacementMinimization,
)
from procedures.strategies.skin_looks import SkinLooks
from procedures.strategies.strategy import ArmInBranch, Strategy
from procedures.strategies.trajectory import Trajectory
from ronna_hw.frames import Transform
from ronna_hw.near_names import find_near

CANDIDATES: tuple[Strategy, ...] = (
    ImprovedDisplacementMinimization(),
    OrientationCorrection(),
    JointDisplacementMinimization(),
)


@dataclass(frozen=True)
class StrategyByTrajectory:
    """Combination of strategies: `others` by trajectory name, `usual` for the rest.

    Each trajectory is localized separately. For a strategy that otherwise localizes once, the poses serve
    that trajectory alone.
    """

    usual: Strategy
    others: Mapping[str, Strategy]
    localizes_per_trajectory: bool = True

    @property
    def name(self) -> str:
        return self.usual.name

    @property
    def learns_arm(self) -> bool:
        return self.usual.learns_arm

    @property
    def controls_approach(self) -> bool:
        """Whether the usual strategy controls the approach. For a single trajectory, see `strategy_for`."""
        return self.usual.controls_approach

    def strategy_for(self, trajectory: str) -> Strategy:
        return self.others.get(trajectory, self.usual)

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return the localization axis of each trajectory's own strategy, named after the trajectory."""
        return tuple(
            replace(axis, identifier=one.identifier)
            for one in trajectories
            for axis in self.strategy_for(one.identifier).localized_along((one,), fiducials_mm, robot_from_ct)
        )

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        return self.strategy_for(along.identifier).localization_poses(along, fiducials_mm, robot_from_ct, arm)

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> Sequence[float]:
        """Return the turns of the trajectory's own strategy, rad."""
        return self.strategy_for(along.identifier).turns_rad(along, fiducials_mm, robot_from_ct, arm)


@dataclass(frozen=True)
class BestOfEach(StrategyByTrajectory):
    """The strategy `best`, which uses for each target the strategy with the smallest predicted error.

    That is known only once the poses the arm can reach are, so path planning chooses. Until then, and if no
    strategy reaches a target, it is the improved JDMS. `others` is the choice, by trajectory.
    """

    usual: Strategy = CANDIDATES[0]
    others: Mapping[str, Strategy] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return "best"


STRATEGIES: tuple[Strategy, ...] = (
    OrientationCorrection(),
    OrientationCorrection(name="thesis-ocs", controls_approach=False),
    NeutralOrientation(),
    JointDisplacementMinimization(),
    ImprovedDisplacementMinimization(),
    BestOfEach(),
    LearningStrategy(),
)


def find_strategy(name: str) -> Strategy:
    """Return the strategy of this name, or that of a scan of the skin. Raises STR-002 for an unknown one."""
    for strategy in (*STRATEGIES, SkinLooks()):
        if strategy.name == name:
            return strategy
    close_matches = find_near(name, [one.name for one in STRATEGIES])
    suggestion = f"Did you mean {close_matches[0]}? {UNKNOWN_STRATEGY.action}" if close_matches else None
    raise UNKNOWN_STRATEGY(f"there is no strategy {name!r}", action=suggestion)
