"""Validity of a theatre's calibration records, and the commands that renew them."""

from __future__ import annotations

import math
import shlex
from collections.abc import Set
from datetime import datetime
from pathlib import Path

from procedures.calibration.errors import ArmOlderThanHead, OfAnotherTheatre
from ronna_hw.calibration import (
    CalibrationExpired,
    DatedRecord,
    Numbers3,
    StereoHeadCalibration,
    ToolTipCalibration,
)
from ronna_hw.config import Calibrations

MADE_BY_COMMAND = {  # in order of creation: each builds on those before it
    "stereo_head": "ronna-stereo calibrate",
    "arm": "ronna-arm calibrate",
    "tracker_frame": "ronna-procedure calibrate tracker-frame",
    "tool_tip": "ronna-procedure calibrate tool-tip",
}
MADE_BY_HAND = {  # no command writes these into the theatre file
    "assistant_arm": "calibrate the assistant as [robot.master] of a theatre file of its own, with ronna-arm "
    "calibrate, and copy its [calibration.arm] to [calibration.assistant_arm]",
    "assistant_holder": "measure the assistant's holder again, and write its record to "
    "[calibration.assistant_holder]",
}

SAME_PLACE_MM = 1e-3  # more than copying a number changes
DRAWN, FIRST_DAY = ("tracker_frame", "tool_tip"), " --first-day"  # simulated records expire only with it


def as_sentence(words: str) -> str:
    """Return words that begin with a capital letter."""
    return words[:1].upper() + words[1:]


def options_of(theatre_file: Path) -> str:
    """Return the command options that read a theatre file and put the new record into it."""
    return f"--config {shlex.quote(str(theatre_file))} --update"


def require_valid(
    calibrations: Calibrations, moment: datetime, options: str = "", starts: Set[str] = frozenset()
) -> None:
    """Raise CAL-001 listing the records that have expired by `moment`, and the commands to renew them.

    `options` select this theatre for those commands; the records in `starts` may have expired. Raises CAL-020
    and CAL-021 like `require_consistent_arm`.
    """
    if "arm" not in starts:
        require_consistent_arm(calibrations, options)
    expired: dict[str, CalibrationExpired] = {}
    for name, record in calibrations.records.items():
        try:
            require_valid_record(name, record, moment, starts)
        except CalibrationExpired as problem:
            if moment <= record.expires:  # dated in the future: a clock is wrong, not a record
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
    new_tip = "tool_tip" in expired and "--sim" not in options
    renew = ", then ronna-tool renew for each tool with that tip" if new_tip else ""
    ways = [f"run {commands}{renew}"] if commands else []
    ways += [words for name, words in MADE_BY_HAND.items() if name in expired]
    raise CalibrationExpired(
        "; ".join(problem.what for problem in expired.values()),
        got=first.got,
        action=f"{as_sentence('; '.join(ways))}; no motion until then.",
    )


def require_valid_record(
    name: str, record: DatedRecord, moment: datetime, starts: Set[str] = frozenset()
) -> None:
    """Raise CAL-001 if a record is dated in the future, or has expired and `starts` does not name it."""
    try:
        record.check_valid_at(moment)
    except CalibrationExpired:
        if name not in starts or moment <= record.expires:
            raise


def require_consistent_arm(calibrations: Calibrations, options: str = "") -> None:
    """Raise CAL-020 or CAL-021 if the arm was not calibrated with this head and tip.

    An arm calibration also determines the head's place and moves the tip with it; both keep their dates. A
    later head calibration attributes the nominal arm's errors to the head's place on the flange.
    """
    arm, head = calibrations.arm, calibrations.stereo_head
    if arm is None:
        return
    if head.created > arm.created:
        raise ArmOlderThanHead(
            f"calibration {arm.identifier} was made before {head.identifier}",
            limit=f"{head.created:%Y-%m-%d %H:%M %Z}",
            got=f"{arm.created:%Y-%m-%d %H:%M %Z}",
            action=f"Run {MADE_BY_COMMAND['arm']} {options}".rstrip() + "; no motion until then.",
        )
    placed_records: tuple[tuple[str, StereoHeadCalibration | ToolTipCalibration, Numbers3 | None], ...] = (
        ("stereo_head", head, arm.stereo_head_mm),
        ("tool_tip", calibrations.tool_tip, arm.tool_tip_mm),
    )
    for name, record, place_mm in placed_records:
        if place_mm is None or record.created > arm.created:  # a tip that was calibrated later
            continue
        distance_mm = math.dist(place_mm, record.flange_from_tool.translation_mm)
        if distance_mm > SAME_PLACE_MM:
            raise OfAnotherTheatre(
                f"calibration {arm.identifier} does not belong to this [calibration.{name}]",
                expected="the record that was written with it",
                got=f"{record.identifier}, {distance_mm:.3f} mm from there on the flange",
                action="Copy the whole calibration.toml of the arm's calibration into the theatre file, or "
                f"run {MADE_BY_COMMAND['arm']} {options}".rstrip()
                + "; no motion until then.",
            )
