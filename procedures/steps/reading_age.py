"""What hands have read off holds for a while: later somebody may have touched it."""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.steps.errors import ReadingTooOld

LONGEST_S = 3600.0  # theatre time; a check on the gauge takes minutes, skin, skull and dura half an hour


def require_recent(context: StepContext, what: str, read_s: float) -> None:
    """Raise TOOL-007 when what was read at that theatre time is relied on too late."""
    age_s = context.setting.clock.now_s() - read_s
    if age_s > LONGEST_S:
        raise ReadingTooOld(
            f"{what}: read too long ago", limit=f"{LONGEST_S / 60:.0f} min", got=f"{age_s / 60:.0f} min"
        )
