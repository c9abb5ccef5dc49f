"""Tool records between the command line and the theatre file."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from procedures.workcell.errors import NoToolRecord
from ronna_hw.bounded_input import read_toml
from ronna_hw.config import BadTheatreFile, parse_theatre, read_theatre_file
from ronna_hw.tool_record import WITH_TIP, ToolRecord


def record_of(config: Path, given: dict[str, Any], name: str) -> dict[str, Any]:
    """The record as the file holds it, with flange and tip of the file; CFG-001 with every mistake in it."""
    theatre = read_theatre_file(config)
    tip = None if theatre.calibration is None else theatre.calibration.tool_tip.identifier
    record = {key: value for key, value in given.items() if value not in (None, {})}
    record.setdefault("flange", theatre.flange)
    if given["purpose"] in {one.value for one in WITH_TIP} and tip is not None:
        record["tip"] = tip
    content = read_toml(config, BadTheatreFile)
    content["tools"] = {**content.get("tools", {}), name: record}
    parse_theatre(content, f"{config.name} with tool {name}")
    return record


def renewed(config: Path, name: str, signed: dict[str, Any], gauge_mm: Sequence[float]) -> dict[str, Any]:
    """The record of a tool for the tip calibration of now; `signed` are its new identity, dates and maker.

    `gauge_mm` are the five dials as read with it. Raises TOOL-002, CFG-001.
    """
    theatre = read_theatre_file(config)
    record = theatre.tools.get(name)
    if record is None or record.gauge is None or theatre.calibration is None:
        raise NoToolRecord(
            f"{config.name} has no tool {name} with a gauge, and a calibration to renew it for"
        )
    content = read_toml(config, BadTheatreFile)
    kept = content["tools"][name]
    x, y, z, upper_x, upper_y = gauge_mm
    read = {"reading_mm": [x, y, z], "upper_reading_mm": [upper_x, upper_y]}
    tip = theatre.calibration.tool_tip.identifier
    new = {**kept, **signed, "tip": tip, "gauge": {**kept["gauge"], **read}}
    content["tools"][name] = new
    parse_theatre(content, f"{config.name} with tool {name}")
    return new


def row_of(name: str, record: ToolRecord, flange: str, now: datetime) -> dict[str, Any]:
    """One line of the list."""
    return {
        "name": name,
        "identifier": record.identifier,
        "purpose": record.purpose.value,
        "number": record.number,
        "mass_kg": record.mass_kg,
        "tip": record.tip or "",
        "expires": f"{record.expires:%Y-%m-%d}",
        "valid": record.created <= now <= record.expires and record.flange == flange,
    }
