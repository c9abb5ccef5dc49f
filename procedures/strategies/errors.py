"""What can go wrong when the arm's orientations are chosen.

StrategyNotYet   STR-001  a strategy of the plan that is not built yet
UnknownStrategy  STR-002  a name that is no strategy
BadTrajectory    STR-003  entry and target are one point, or a number is not finite
"""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError


class StrategyNotYet(ConfigurationError):
    """The strategy is planned but not implemented yet."""

    code = "STR-001"
    action = "Use the strategy ocs."


class UnknownStrategy(ConfigurationError):
    """No strategy has this name."""

    code = "STR-002"
    action = "Use one of: ocs, thesis-ocs, nos, jdms, improved, best."


class BadTrajectory(DataError):
    """Entry and target are one point, or a number is not finite."""

    code = "STR-003"
    action = "Correct the trajectory in the plan."
