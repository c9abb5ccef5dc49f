"""Whether the calibration records of a theatre may be used, and which command makes each of them."""

from __future__ import annotations

from datetime import datetime

from ronna_hw.calibration import CalibrationExpired
from ronna_hw.config import Calibrations

MADE_BY_COMMAND = {  # in the order in which they are made: each builds on those before it
    "stereo_head": "ronna-stereo calibrate",
    "arm": "ronna-arm calibrate",
    "tracker_frame": "ronna-procedure calibrate tracker-frame",
    "tool_tip": "ronna-procedure calibrate tool-tip",
}

DRAWN, FIRST_DAY = ("tracker_frame", "tool_tip"), " --first-day"  # simulated records expire only there


def require_valid(calibrations: Calibrations, moment: datetime, options: str = "") -> None:
    """Raise CAL-001 with every record that has expired at a moment and the commands that make them.

    `options` are those with which they are given this theatre.
    """
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
    commands = ", then ".join(
        f"{command} {options}{FIRST_DAY if name in DRAWN and '--sim' in options else ''}".rstrip()
        for name, command in MADE_BY_COMMAND.items()
        if name in expired
    )
    raise CalibrationExpired(
        "; ".join(problem.what for problem in expired.values()),
        limit=first.limit,
        got=first.got,
        action=f"Run {commands}; no motion until then.",
    )
