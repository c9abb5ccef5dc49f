"""What a case came to, for comparing two."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from operated_case import OperatedCase
from user_commands import in_this_process

from sim.cli import app as ronna_sim

MEASURED = (
    "fiducial_localization",
    "correspondence",
    "relocalization",
    "registration",
    "at_target",
    "positioning",
)


OF_ALL_READINGS = ("pushed_mm",)
"""Payload keys whose figures depend on the number of readings, and so on the host's pace."""


def outcome_of(case: OperatedCase) -> dict[str, Any]:
    """What the command printed at its end."""
    return dict(json.loads(case.output.read_text(encoding="utf-8")))


def measured(run: Path) -> dict[str, Any]:
    """The results of its measurements, by record.

    Without what depends on how many readings came before: the largest push on a guide. Slow hands leave
    time for more readings.
    """
    records = [json.loads(path.read_text()) for path in sorted((run / "records").glob("*.json"))]
    return {
        one["identifier"]: {key: value for key, value in one["payload"].items() if key not in OF_ALL_READINGS}
        for one in records
        if one["kind"] in MEASURED
    }


def targets(run: Path) -> list[dict[str, Any]]:
    """How far off each target truly is."""
    verified = in_this_process(ronna_sim, "verify", run, "--json")
    return list(json.loads(verified.stdout)["targets"])
