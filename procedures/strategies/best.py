"""The strategy `best`: for each target the one with the smallest predicted error.

That is known only once the poses the arm can reach are, so it is chosen during path planning. Until then, and
if no strategy reaches a target, it is the improved JDMS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from procedures.strategies.by_trajectory import StrategyByTrajectory
from procedures.strategies.improved import ImprovedDisplacementMinimization
from procedures.strategies.jdms import JointDisplacementMinimization
from procedures.strategies.ocs import OrientationCorrection
from procedures.strategies.strategy import Strategy

CANDIDATES: tuple[Strategy, ...] = (
    ImprovedDisplacementMinimization(),
    OrientationCorrection(),
    JointDisplacementMinimization(),
)


@dataclass(frozen=True)
class BestOfEach(StrategyByTrajectory):
    """`others` is the choice made, by trajectory."""

    usual: Strategy = CANDIDATES[0]
    others: Mapping[str, Strategy] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its own name."""
        return "best"
