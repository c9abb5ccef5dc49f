"""What a case came to, for comparing two."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from operated_case import OperatedCase

MEASURED = (
    "fiducial_localization",
    "correspondence",
    "relocalization",
    "registration",
    "at_target",
    "positioning",
)


def outcome_of(case: OperatedCase) -> dict[str, Any]:
    """What the command printed at its end."""
    return dict(json.loads(case.output.read_text(encoding="utf-8")))


def measured(run: Path) -> dict[str, Any]:
    """The results of its measurements, by record."""
    records = [json.loads(path.read_text()) for path in sorted((run / "records").glob("*.json"))]
    return {one["identifier"]: one["payload"] for one in records if one["kind"] in MEASURED}
