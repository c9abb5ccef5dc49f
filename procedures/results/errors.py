"""Results that are missing, or outside their limits."""

from __future__ import annotations

from ronna_hw.errors import RefusedError


class StepRefused(RefusedError):
    """A step cannot start: the listed preconditions are not met."""

    code = "PRO-001"
    action = "Meet the listed preconditions, or run the steps that come before."


class GateFailed(RefusedError):
    """A result is outside the limits that it must meet before the procedure continues."""

    code = "PRO-007"
    action = "Compare the value with its limit; repeat the step or correct its inputs."
