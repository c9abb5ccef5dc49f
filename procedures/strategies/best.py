"""The strategy `best`: for each target the one whose predicted error is smallest.

Which that is shows only with the poses that the arm reaches, so it is chosen when the paths are planned.
Until then, and where none is reached, it is the improved JDMS.
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
    """`others` holds what was chosen, by trajectory."""

    usual: Strategy = CANDIDATES[0]
    others: Mapping[str, Strategy] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its own."""
        return "best"
