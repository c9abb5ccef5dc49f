"""Errors in choosing the arm's orientations, STR-002 to STR-004."""

from __future__ import annotations

from procedures.strategies.names import STRATEGY_NAMES
from ronna_hw.errors import ConfigurationError, DataError, ErrorCode, LimitError

UNKNOWN_STRATEGY = ErrorCode(
    "STR-002", ConfigurationError, "No strategy has this name.", f"Use one of: {', '.join(STRATEGY_NAMES)}."
)


BAD_TRAJECTORY = ErrorCode(
    "STR-003",
    DataError,
    "Entry and target coincide, or a number is not finite, or not in its place and range.",
    "Correct the trajectory in the plan.",
)


class NoNearbyJoints(LimitError):
    """No joint angles close to those at the target bring the tool to a fiducial."""

    code = "STR-004"
    action = "Use the strategy ocs or nos, or move the cart or the head."
