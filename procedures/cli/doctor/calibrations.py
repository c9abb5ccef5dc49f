"""The calibration records of a theatre file: whether they are there, and until when they are valid."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from ronna_hw.config import TheatreFile
from ronna_hw.devices.probing import Diagnostic

CALIBRATE = {
    "stereo_head": "Run ronna-stereo calibrate --config FILE.",
    "tool_tip": "Measure the tip of the guide again, and enter the new record.",
    "arm": "Run ronna-arm calibrate --config FILE.",
    "tracker_frame": "Measure the reference frame on the mount again, and enter the new record.",
}


def calibration_diagnostics(theatre: TheatreFile, now: datetime) -> Iterator[Diagnostic]:
    """One for each record; that there are none is a problem where the file has what a case needs to move."""
    if theatre.calibration is None:
        needed = bool(theatre.robot) and theatre.stereo is not None
        advice = "Add [calibration]: without its records no case can be run." if needed else ""
        yield Diagnostic("calibrations", not needed, "none in the theatre file", advice)
        return
    for name, record in theatre.calibration.records.items():
        advice = CALIBRATE[name]
        valid = now <= record.expires
        until = f"{'valid until' if valid else 'expired on'} {record.expires:%Y-%m-%d %H:%M %Z}"
        yield Diagnostic(
            f"calibration {name}", valid, f"{record.identifier}, {until}", "" if valid else advice
        )
