"""The verdict on the error at a target, known or predicted, against the margin that the plan accepts."""

from __future__ import annotations

from enum import StrEnum

# Said wherever a predicted error stands whose limit, at `DEFAULT_CONFIDENCE`, the plan does not accept.
LIMIT_BEYOND_MARGIN = "95 % limit beyond the margin"


class MarginVerdict(StrEnum):
    """Verdict on an error at a target against the margin of the plan, in the words of a report."""

    WITHIN = "within"
    BEYOND = "beyond"
    PREDICTED_WITHIN = "predicted within"
    LIMIT_BEYOND = "rms within, limit beyond"
    PREDICTED_BEYOND = "predicted beyond"

    @property
    def colour(self) -> str:
        """Class of a page for it: ok, warn or bad."""
        if self is MarginVerdict.LIMIT_BEYOND:
            return "warn"
        return "bad" if self in (MarginVerdict.BEYOND, MarginVerdict.PREDICTED_BEYOND) else "ok"


def judge_error(
    margin_mm: float, rms_mm: float, limit_mm: float, known_mm: float | None = None
) -> MarginVerdict:
    """Judge the known error at a target, or if none is known, rms and limit of the predicted one."""
    if known_mm is not None:
        return MarginVerdict.WITHIN if known_mm <= margin_mm else MarginVerdict.BEYOND
    if rms_mm > margin_mm:
        return MarginVerdict.PREDICTED_BEYOND
    return MarginVerdict.PREDICTED_WITHIN if limit_mm <= margin_mm else MarginVerdict.LIMIT_BEYOND


def remark_on_limit(verdict: MarginVerdict | None, margin_mm: float | None, limit_mm: float) -> str:
    """Return the remark on a known error within the margin of which more was predicted, or ''."""
    if margin_mm is None or verdict is not MarginVerdict.WITHIN or limit_mm <= margin_mm:
        return ""
    return LIMIT_BEYOND_MARGIN
