"""The strategies by name."""

from __future__ import annotations

from difflib import get_close_matches

from procedures.strategies.best import BestOfEach
from procedures.strategies.errors import UnknownStrategy
from procedures.strategies.improved import ImprovedDisplacementMinimization
from procedures.strategies.jdms import JointDisplacementMinimization
from procedures.strategies.nos import NeutralOrientation
from procedures.strategies.ocs import OrientationCorrection
from procedures.strategies.strategy import Strategy

STRATEGIES: tuple[Strategy, ...] = (
    OrientationCorrection(),
    OrientationCorrection(name="thesis-ocs", controls_approach=False),
    NeutralOrientation(),
    JointDisplacementMinimization(),
    ImprovedDisplacementMinimization(),
    BestOfEach(),
)


def strategy_named(name: str) -> Strategy:
    """The strategy with this name. Raises STR-002 for an unknown one."""
    for strategy in STRATEGIES:
        if strategy.name == name:
            return strategy
    alike = get_close_matches(name.lower(), [one.name for one in STRATEGIES], n=1)
    meant = f"Did you mean {alike[0]}? {UnknownStrategy.action}" if alike else None
    raise UnknownStrategy(f"there is no strategy {name!r}", action=meant)
