"""A run that was killed, left or interrupted is taken up again: compared first, accepted then, moved last."""

from procedures.recovery.taking_up import recover

__all__ = ["recover"]
