"""Conversion of tool records between the command line and the theatre file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from procedures.planning.errors import NO_TOOL_RECORD
from procedures.planning.tool_records import GUIDE, ToolRecords
from ronna_hw.bounded_input import read_bounded, read_toml
from ronna_hw.clock import HostClock
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.config import BadTheatreFile, Calibrations, TheatreFile, parse_theatre, read_theatre_file
from ronna_hw.devices.robot import RobotArm
from ronna_hw.near_names import find_near
from ronna_hw.registry import make_device
from ronna_hw.roles import MASTER
from ronna_hw.tool_record import GAUGE_APPROACHES, GAUGE_MOUNTINGS, WITH_TIP, Gauge, ToolRecord

DIALS = ("X", "Y", "Z", "UPPER_X", "UPPER_Y")
LARGEST_BYTES = 100_000
GIVE_OPTIONS = (
    "Correct the options; a guide needs --reach-mm, --bore-mm and --play-mm. "
    "docs/reference/theatre-file.md describes the keys of [tools]."
)
# Six standard deviations of an arm's arrival, a changer's seat and a dial together: farther is misread.
APART_MM = 0.1


def read_gauge(path: Path, gauge: Gauge) -> dict[str, Any]:
    """Read gauge readings and return their mean and spread as gauge fields. Raises CLI-001."""
    if path.is_dir():
        raise UsageMistake(
            f"--gauge-mm: {path} is a folder",
            expected="a text file with one line for each approach: the five dials in mm",
            action="Give that file.",
        )
    lines = read_bounded(path, LARGEST_BYTES).decode("utf-8-sig", "replace").splitlines()
    lines_read = [
        _numbers(f"{path.name}:{number}", line) for number, line in enumerate(lines, 1) if line.strip()
    ]
    if len(lines_read) < GAUGE_APPROACHES:
        raise UsageMistake(
            f"--gauge-mm: {path.name} has {len(lines_read)} approaches",
            expected=f"at least {GAUGE_APPROACHES}, in {GAUGE_MOUNTINGS} mountings",
            action="One line for each approach: the five dials in mm.",
        )
    lowest_mm, highest_mm = gauge.plausible_mm
    middle = np.median([numbers for _, numbers in lines_read], axis=0).tolist()
    for source, numbers in lines_read:
        for dial, reading_mm, usual_mm in zip(DIALS, numbers, middle, strict=True):
            if not lowest_mm <= reading_mm <= highest_mm:
                raise UsageMistake(
                    f"--gauge-mm: {source}: {dial} is {reading_mm:g}",
                    expected=f"{lowest_mm:.2f} to {highest_mm:.2f} mm: a dial travels {gauge.travel_mm:g} mm",
                    action="Read the dials again; if their travel differs, set `travel_mm` of the gauge.",
                )
            if abs(reading_mm - usual_mm) > APART_MM:
                raise UsageMistake(
                    f"--gauge-mm: {source}: {dial} is {reading_mm:g}",
                    expected=f"within {APART_MM:g} mm of the others, whose median is {usual_mm:g}",
                    action="Seat tool and mandrel anew, and read all approaches again.",
                )
    values = np.array([numbers for _, numbers in lines_read])
    x, y, z, upper_x, upper_y = values.mean(axis=0).round(6).tolist()
    return {
        "reading_mm": [x, y, z],
        "upper_reading_mm": [upper_x, upper_y],
        "approaches": len(values),
        "spread_mm": round(float(np.sqrt(values.var(axis=0, ddof=1).mean())), 6),
    }


def _numbers(source: str, line: str) -> tuple[str, list[float]]:
    """Parse one reading of all dials from a line; return it with the line's source. Raises CLI-001."""
    try:
        numbers = [float(word) for word in line.split()] if line.isascii() and "_" not in line else []
    except ValueError:
        numbers = []
    if len(numbers) != len(DIALS):
        raise UsageMistake(
            f"--gauge-mm: {source}: {line.strip()[:40]!r}",
            expected=f"five numbers, {' '.join(DIALS)}",
            action="Write them with decimal points, and spaces between them.",
        )
    return source, numbers


def record_of(
    config: Path, given: dict[str, Any], name: str, readings: Path | None
) -> tuple[dict[str, Any], list[str]]:
    """Return a tool record in file format, with flange and tip, and the names of tables it drops.

    `readings` are those of its gauge.

    Raises CFG-001 with every mistake in it, CLI-001 for a gauge out of the arm's reach or misread, or a name
    that the file already has.
    """
    theatre = read_theatre_file(config)
    record = {key: value for key, value in given.items() if value not in (None, {})}
    record.setdefault("flange", theatre.flange)
    if given["purpose"] in {one.value for one in WITH_TIP} and theatre.calibration is not None:
        record |= _tip_fields(theatre.calibration)
    for known in theatre.tools:
        if known != name and known.casefold() == name.casefold():
            raise UsageMistake(
                f"{config.name} has a tool {known!r}: {name!r} would be another one next to it",
                action=f"Did you mean {known}? Else give it a name that differs by more than capitals.",
            )
    content = read_toml(config, BadTheatreFile)
    former = content.get("tools", {}).get(name, {})
    content["tools"] = {**content.get("tools", {}), name: record}
    out_of_range = _out_of_range(record.get("gauge", {}).get("joints_deg"), theatre)
    try:
        parsed = parse_theatre(content, f"{config.name} with tool {name}")
    except BadTheatreFile as error:
        if out_of_range is None:
            raise error.reworded(error.what, action=GIVE_OPTIONS) from error
        raise BadTheatreFile(f"{error.what}; besides, {out_of_range.summary}") from error
    if out_of_range is not None:
        raise out_of_range
    if name == GUIDE:
        _ = ToolRecords.of(parsed).guide  # no case would start without one
    gauge = parsed.tools[name].gauge
    if gauge is not None and readings is not None:
        record["gauge"] |= read_gauge(readings, gauge)
    return record, [f"[tools.{name}.{key}]" for key in former if key not in record]


def _tip_fields(calibrations: Calibrations) -> dict[str, Any]:
    return {
        "tip": calibrations.tool_tip.identifier,
        "tip_in_head": calibrations.tip_in_head.model_dump(mode="json"),
    }


def _out_of_range(joints_deg: Sequence[float] | None, theatre: TheatreFile) -> UsageMistake | None:
    """Explain why the theatre's arm cannot reach the gauge; return None if it can, or without an arm."""
    config = theatre.robot.get(MASTER)
    arm = (
        None if config is None or joints_deg is None else make_device(f"robot.{MASTER}", config, HostClock())
    )
    if joints_deg is None or not isinstance(arm, RobotArm):
        return None
    ranges = arm.kinematics
    for axis, angle_deg, lower, upper in zip(
        ranges.axis_names, joints_deg, ranges.lower_rad, ranges.upper_rad, strict=True
    ):
        if angle_deg < math.degrees(lower) or angle_deg > math.degrees(upper):
            return UsageMistake(
                f"--gauge-deg: {axis} is {angle_deg:g} degrees",
                expected=f"{math.degrees(lower):g} to {math.degrees(upper):g}, the range of that axis",
                action="Read the axes at the pendant, with the mandrel in the gauge.",
            )
    return None


def renew_record(
    config: Path, name: str, signed: dict[str, Any], readings: Path
) -> tuple[dict[str, Any], list[str]]:
    """Renew a tool's record for the current tip calibration; also return remarks on what changed.

    `signed` has its new identity, dates and maker, `readings` is the file of dial readings with it. Raises
    TOOL-002, CFG-001, CLI-001.
    """
    theatre = read_theatre_file(config)
    with_gauge = {known: tool.gauge for known, tool in theatre.tools.items() if tool.gauge is not None}
    gauge = with_gauge.get(name)
    if gauge is None:
        near_names = find_near(name, with_gauge)
        raise NO_TOOL_RECORD(
            f"{config.name} has no tool {name!r} with a gauge",
            expected=", ".join(with_gauge) or "one with [tools.NAME.gauge]",
            action=f"Did you mean {near_names[0]}?" if near_names else None,
        )
    if theatre.calibration is None:
        raise NO_TOOL_RECORD(f"{config.name} has no calibration to renew {name} for")
    content = read_toml(config, BadTheatreFile)
    former_record = content["tools"][name]
    new = {**former_record, **signed, **_tip_fields(theatre.calibration)}
    new["gauge"] = {**former_record["gauge"], **read_gauge(readings, gauge)}
    content["tools"][name] = new
    parse_theatre(content, f"{config.name} with tool {name}")
    read_off_mm = math.dist(gauge.reading_mm, new["gauge"]["reading_mm"])
    read_off = f"the mandrel reads {read_off_mm:.3f} mm from where the former record of {name} has it"
    if (recorded := theatre.tools[name].tip_in_head) is None:
        return new, [read_off]
    off_mm, off_rad = recorded.off(theatre.calibration.tip_in_head)
    off = f"{off_mm:.3f} mm and {math.degrees(off_rad):.3f} deg"
    if abs(read_off_mm - off_mm) > APART_MM:
        read_off = (
            f"warning: {read_off}; expected as much as the tip within {APART_MM:g} mm, unless the gauge was "
            "moved or zeroed since: is it this tool, and well seated?"
        )
    return new, [f"the tip is {off} from where the former record of {name} has it", read_off]


def row_of(name: str, record: ToolRecord, flange: str, now: datetime) -> dict[str, Any]:
    is_valid = record.created <= now <= record.expires and record.flange == flange
    named = {"name": name, "identifier": record.identifier, "purpose": record.purpose.value}
    tool = {"number": record.number, "mass_kg": record.mass_kg, "tip": record.tip or ""}
    return {**named, **tool, "expires": f"{record.expires:%Y-%m-%d}", "valid": is_valid}
