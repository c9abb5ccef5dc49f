"""Figures of a case with two arms, for `--json`: how well the bases are known, and how it was inserted."""

from __future__ import annotations

from typing import Any

from procedures.reporting.run_reading import RunReading
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import KnownBases


def collect_two_arms(reading: RunReading) -> dict[str, Any]:
    """Return `bases`, None unless they are known, and `insertions` by the assistant, by trajectory."""
    known = reading.find(KnownBases)
    reached = reading.standing(ReachedTarget)
    return {
        "bases": None if known is None else _describe_bases(known),
        "insertions": {
            str(one.record.trajectory): one.result.assisted.model_dump(mode="json")
            for one in reached
            if one.result.assisted is not None
        },
    }


def _describe_bases(known: KnownBases) -> dict[str, Any]:
    figures = known.model_dump(
        mode="json",
        include={
            "robot_from_base",
            "error_mm",
            "by_frames_mm",
            "apart_mm",
            "scatter_mm",
            "frame_looks",
            "ball_looks",
            "outliers",
        },
    )
    return {"meeting_mm": known.meeting_mm, **figures}
