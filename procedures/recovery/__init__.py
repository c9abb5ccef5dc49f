"""Resumes a run that was killed, left or interrupted: compare first, then accept, move last."""

from procedures.recovery.taking_up import bring_home, recover

__all__ = ["bring_home", "recover"]
