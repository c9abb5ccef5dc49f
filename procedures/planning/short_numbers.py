"""Short numbers that tell series and plans apart on a screen and on paper, without naming the patient."""

from __future__ import annotations

import hashlib

from procedures.planning.plan_model import Plan
from ronna_hw.records import canonical_json

DIGITS = 8  # hex: enough to tell two series, or two plans, apart at a glance


def short_series_number(series_instance_uid: str) -> str:
    """Return the beginning of the SHA-256 of a series UID."""
    return hashlib.sha256(series_instance_uid.encode()).hexdigest()[:DIGITS]


def short_plan_number(plan: Plan) -> str:
    """Return the beginning of the SHA-256 of all that a plan states. Its seal and its file do not count."""
    content = plan.model_dump(mode="json", by_alias=True, exclude_none=True, exclude={"seal"})
    return hashlib.sha256(canonical_json(content)).hexdigest()[:DIGITS]
