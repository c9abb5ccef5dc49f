"""Errors in choosing the arm's orientations, STR-002 to STR-004."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, LimitError


class UnknownStrategy(ConfigurationError):
    """No strategy has this name."""

    code = "STR-002"
    action = "Use one of: ocs, thesis-ocs, nos, jdms, improved, best."


class BadTrajectory(DataError):
    """Entry and target coincide, or a number is not finite, or not in its place and range."""

    code = "STR-003"
    action = "Correct the trajectory in the plan."


class NoNearbyJoints(LimitError):
    """No joint angles close to those at the target bring the tool to a fiducial."""

    code = "STR-004"
    action = "Use the strategy ocs or nos, or move the cart or the head."
