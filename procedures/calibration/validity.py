"""Whether the calibration records of a theatre may be used, and which command makes each of them."""

from __future__ import annotations

from datetime import datetime

from ronna_hw.calibration import CalibrationExpired
from ronna_hw.config import Calibrations

MADE_BY_COMMAND = {
    "stereo_head": "ronna-stereo calibrate",
    "tool_tip": "ronna-procedure calibrate tool-tip",
    "tracker_frame": "ronna-procedure calibrate tracker-frame",
    "arm": "ronna-arm calibrate",
}


def require_valid(calibrations: Calibrations, moment: datetime) -> None:
    """Raise CAL-001 with every record that has expired at a moment and the commands that make them."""
    expired: dict[str, CalibrationExpired] = {}
    for name, record in calibrations.records.items():
        try:
            record.check_valid_at(moment)
        except CalibrationExpired as problem:
            if problem.limit is None:  # dated in the future: a clock is wrong, no record
                raise
            expired[name] = problem
    if not expired:
        return
    first = next(iter(expired.values()))
    commands = ", then ".join(MADE_BY_COMMAND[name] for name in expired)
    raise CalibrationExpired(
        "; ".join(problem.what for problem in expired.values()),
        limit=first.limit,
        got=first.got,
        action=f"Run {commands}; no motion until then.",
    )
