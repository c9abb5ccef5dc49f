"""A run that was killed, left or interrupted is resumed: compared first, accepted then, moved last."""

from procedures.recovery.taking_up import bring_home, recover

__all__ = ["bring_home", "recover"]
