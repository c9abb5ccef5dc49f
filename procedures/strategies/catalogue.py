"""The strategies by name."""

from __future__ import annotations

from procedures.strategies.errors import StrategyNotYet, UnknownStrategy
from procedures.strategies.jdms import JointDisplacementMinimization
from procedures.strategies.nos import NeutralOrientation
from procedures.strategies.ocs import OrientationCorrection
from procedures.strategies.strategy import Strategy

STRATEGIES: tuple[Strategy, ...] = (
    OrientationCorrection(),
    OrientationCorrection(name="thesis-ocs", controls_approach=False),
    NeutralOrientation(),
    JointDisplacementMinimization(),
)
NOT_YET = {
    "improved": "joint displacement minimization on a calibrated arm",
    "best": "the best of all strategies",
}


def strategy_named(name: str) -> Strategy:
    """The strategy with this name. Raises STR-001 for one that is not built yet, STR-002 for an unknown."""
    for strategy in STRATEGIES:
        if strategy.name == name:
            return strategy
    if name in NOT_YET:
        raise StrategyNotYet(f"the strategy {name} ({NOT_YET[name]}) is not yet available")
    raise UnknownStrategy(f"there is no strategy {name!r}")
