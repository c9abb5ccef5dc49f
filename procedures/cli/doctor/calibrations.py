"""Diagnostics of the calibration and tool records in a theatre file: presence, consistency and expiry."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from procedures.calibration import validity
from procedures.calibration.errors import ArmOlderThanHead, OfAnotherTheatre
from procedures.planning.tool_records import GUIDE, RENEW, ToolRecords
from procedures.runs.theatre_history import TheatreState, describe_state, read_states
from ronna_hw.bounded_input import parse_toml_bytes
from ronna_hw.calibrated_arm import error_budget
from ronna_hw.calibration import CalibrationExpired
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.config import BadTheatreFile, Calibrations, TheatreFile
from ronna_hw.devices.probing import Diagnostic, refusal
from ronna_hw.errors import RonnaError
from ronna_hw.tool_record import GAUGE_APPROACHES, ToolRecord

EXPIRY_NOTICE = timedelta(days=3)  # before its expiry a record is mentioned
RECORD_TABLES = ("calibration", "tools")
ADDED_BY_HAND = "tools"  # fields such as `bodies`, which no command writes, may be added to a record


def calibration_diagnostics(theatre: TheatreFile, path: Path, now: datetime) -> Iterator[Diagnostic]:
    """Yield one diagnostic per calibration record, in the order in which the records are created.

    Missing records are a problem if the file has what a case needs to move.
    """
    if theatre.calibration is None:
        needed = bool(theatre.robot) and theatre.stereo is not None
        advice = "Add [calibration]: no case can run without its records." if needed else ""
        yield Diagnostic("calibrations", not needed, "none in the theatre file", advice)
        return
    records = theatre.calibration.records
    for name in (one for one in (*validity.MADE_BY_COMMAND, *validity.MADE_BY_HAND) if one in records):
        record = records[name]
        subject, by_hand = f"calibration {name}", validity.MADE_BY_HAND.get(name)
        command = "" if by_hand else f"{validity.MADE_BY_COMMAND[name]} {validity.options_of(path)}"
        renewal = f"{validity.as_sentence(by_hand)}." if by_hand else "Calibrate again."
        if name == "tool_tip" and theatre.tools:
            renewal += f" Afterwards: {RENEW}"
        try:
            record.check_valid_at(now)
        except CalibrationExpired as error:
            expired = refusal(subject, error)
            is_in_future = record.created > now  # a clock is wrong, not a record
            yield expired if is_in_future else replace(expired, advice=renewal, command=command)
            continue
        if name == "arm":
            try:
                validity.require_consistent_arm(theatre.calibration, validity.options_of(path))
            except (ArmOlderThanHead, OfAnotherTheatre) as error:
                yield replace(refusal(subject, error), command=command)
                continue
        text = f"{record.identifier}, valid until {record.expires:%Y-%m-%d %H:%M %Z}"
        valid = Diagnostic(subject, True, text)
        expires_soon = record.expires - now < EXPIRY_NOTICE
        yield replace(valid, advice=renewal, command=command) if expires_soon else valid


def history_diagnostics(path: Path) -> Iterator[Diagnostic]:
    """Warn of records edited by hand under a former identifier, and of a history that was changed."""
    try:
        edited = edited_records(path)
    except (OSError, RonnaError) as problem:
        error = as_ronna_error(problem)
        yield Diagnostic("history", True, f"{error.code} {error.summary}", error.advice)
        return
    command = f"ronna-procedure theatre-history {shlex.quote(str(path))}"
    for one in edited:
        yield Diagnostic(
            f"record {one.place}",
            True,
            f"{one.identifier} is not as it was put in ({one.since}): {', '.join(one.fields)} edited by hand",
            "Put the former values back, or measure again: a new record has an identifier of its own.",
            command=command,
        )


@dataclass(frozen=True)
class EditedRecord:
    """A record whose values are not those of the update, or first state, that its identifier came with."""

    place: str  # such as `calibration.tool_tip`
    identifier: str
    fields: tuple[str, ...]
    since: str  # what led to the state with its values


def edited_records(theatre: Path) -> tuple[EditedRecord, ...]:
    """Compare the records of a theatre file with its history. Raises PRO-046, OSError."""
    known: dict[str, tuple[TheatreState, dict[str, Any]]] = {}
    above: dict[str, dict[str, Any]] = {}
    for state in read_states(theatre):
        now = dict(_records(state))
        for place, record in now.items():
            is_signed = state.update is not None and above.get(place) != record
            if is_signed or place not in known or known[place][1]["identifier"] != record["identifier"]:
                known[place] = state, record
        above = now
    return tuple(
        EditedRecord(place, record["identifier"], fields, describe_state(known[place][0]))
        for place, record in above.items()
        if (fields := tuple(_changed_fields(place, known[place][1], record)))
    )


def _records(state: TheatreState) -> Iterator[tuple[str, dict[str, Any]]]:
    content = parse_toml_bytes(state.text.encode(), f"state {state.number}", BadTheatreFile)
    for table in RECORD_TABLES:
        for name, record in content.get(table, {}).items():
            if isinstance(record, dict) and "identifier" in record:
                yield f"{table}.{name}", record


def _changed_fields(place: str, then: dict[str, Any], now: dict[str, Any]) -> Iterator[str]:
    for field in sorted(then.keys() | now.keys()):
        is_added = field not in then and place.startswith(f"{ADDED_BY_HAND}.")
        if then.get(field) != now.get(field) and not is_added:
            yield field


def setting_diagnostics(theatre: TheatreFile) -> Iterator[Diagnostic]:
    """Report the arm and tool frame errors assumed in predictions, and why they exceed those configured."""
    if theatre.calibration is None:
        return
    settings, arm = theatre.procedure, theatre.calibration.arm
    sizes, used_mm = error_budget.ErrorSizes.stated(settings, arm), error_budget.arm_error_mm(settings, arm)
    advice = (
        f"The best arms without [calibration.arm] are off by {error_budget.UNCALIBRATED_MM:g} mm per axis, "
        f"their tool frames by {error_budget.LINK_TRANSLATION_MM:g} mm: errors are predicted with that, not "
        "with less in [procedure]. Calibrate the arm."
    )
    is_too_optimistic = used_mm > settings.arm_error_mm or sizes.tool_mm > settings.tool_error_mm
    description = f"{used_mm:.2g} mm per axis, of the tool frame {sizes.tool_mm:.2g} mm"
    yield Diagnostic(
        "error of the arm", True, description, advice if arm is None and is_too_optimistic else ""
    )


def tool_diagnostics(theatre: TheatreFile, path: Path, now: datetime) -> Iterator[Diagnostic]:
    """Report whether the tool records are valid and match the flange and the calibrated tip."""
    if theatre.calibration is None:
        return
    try:
        ToolRecords.of(theatre).check(theatre.calibration, now)
    except RonnaError as error:
        options = f"--config {shlex.quote(str(path))} --by 'YOUR NAME' --gauge-mm DIALS_FILE"
        command = f"ronna-tool renew {GUIDE} {options}" if RENEW in error.advice else ""
        yield replace(refusal("tool records", error), command=command)
    else:
        guide = theatre.tools.get(GUIDE)
        advice = "" if guide is None else " ".join(_guide_advice(guide, theatre.calibration))
        yield Diagnostic("tool records", True, ", ".join(theatre.tools), advice)


def _guide_advice(guide: ToolRecord, calibrations: Calibrations) -> Iterator[str]:
    tip_mm = math.hypot(*calibrations.tool_tip.flange_from_tool.translation_mm)
    weight_mm = math.hypot(*guide.centre_of_gravity_mm)
    if weight_mm >= tip_mm:  # beyond its own end: a value is likely mistyped
        yield (
            f"The tip of the {GUIDE} is {tip_mm:.0f} mm from the flange, its centre of gravity "
            f"{weight_mm:.0f} mm: check [calibration.tool_tip] and [tools.{GUIDE}]."
        )
    if guide.tip_in_head is None:
        yield f"[tools.{GUIDE}] has no tip_in_head, so a tip edited since is not noticed. {RENEW}"
    if guide.gauge is not None and guide.gauge.approaches < GAUGE_APPROACHES:
        yield (
            f"[tools.{GUIDE}.gauge] is the mean of {guide.gauge.approaches} approaches, not of "
            f"{GAUGE_APPROACHES}: good guides may be refused. {RENEW}"
        )
