"""The strategies by name."""

from __future__ import annotations

from procedures.strategies.errors import StrategyNotYet, UnknownStrategy
from procedures.strategies.ocs import OrientationCorrection
from procedures.strategies.strategy import Strategy

NOT_YET = {
    "nos": "neutral orientation",
    "jdms": "joint displacement minimization",
    "improved": "joint displacement minimization on a calibrated arm",
    "thesis-ocs": "orientation correction as in the thesis, without control of the approach",
    "best": "the best of all strategies",
}


def strategy_named(name: str) -> Strategy:
    """The strategy with this name. Raises STR-001 for one that is not built yet, STR-002 for an unknown."""
    if name == "ocs":
        return OrientationCorrection()
    if name in NOT_YET:
        raise StrategyNotYet(f"the strategy {name} ({NOT_YET[name]}) is not yet available")
    raise UnknownStrategy(f"there is no strategy {name!r}")
