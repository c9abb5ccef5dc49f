"""The calibration records of a theatre file: whether they are there, and until when they are valid."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime

from procedures.calibration.validity import MADE_BY_COMMAND
from ronna_hw.config import TheatreFile
from ronna_hw.devices.probing import Diagnostic


def calibration_diagnostics(theatre: TheatreFile, now: datetime) -> Iterator[Diagnostic]:
    """One for each record; that there are none is a problem where the file has what a case needs to move."""
    if theatre.calibration is None:
        needed = bool(theatre.robot) and theatre.stereo is not None
        advice = "Add [calibration]: without its records no case can be run." if needed else ""
        yield Diagnostic("calibrations", not needed, "none in the theatre file", advice)
        return
    for name, record in theatre.calibration.records.items():
        advice = f"Run {MADE_BY_COMMAND[name]} --config FILE."
        valid = now <= record.expires
        until = f"{'valid until' if valid else 'expired on'} {record.expires:%Y-%m-%d %H:%M %Z}"
        yield Diagnostic(
            f"calibration {name}", valid, f"{record.identifier}, {until}", "" if valid else advice
        )
