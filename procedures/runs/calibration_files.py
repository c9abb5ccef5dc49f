"""Files written by a calibration: records, figures and an updated theatre file.

OUT/<id>/calibration.toml    the new records, to put into the theatre file
OUT/<id>/result.json         the output of `--json`
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

from procedures.calibration.errors import BAD_OBSERVATIONS
from procedures.reporting.calibration_figures import RecordFigures, read_figures
from procedures.runs.theatre_history import UpdateAuthor, update_tables
from ronna_hw.bounded_input import read_toml
from ronna_hw.command_line import terminal
from ronna_hw.config import BadTheatreFile, Calibrations
from ronna_hw.evidence.manifest import RESULT_FILE
from ronna_hw.records import write_atomically

CALIBRATION_FILE = "calibration.toml"


def write_records(records: dict[str, Any], folder: Path) -> None:
    """Write new calibration records to `calibration.toml`, keyed by their names in the theatre file."""
    import tomli_w

    write_atomically(folder / CALIBRATION_FILE, tomli_w.dumps({"calibration": records}).encode())


def require_records(folders: Iterable[Path]) -> None:
    """Raise CAL-005 for a folder or file without calibration records."""
    for folder in folders:
        file = folder / CALIBRATION_FILE if folder.is_dir() else folder
        try:
            content = read_toml(file, BAD_OBSERVATIONS)
        except OSError as error:
            raise BAD_OBSERVATIONS(f"cannot read {file}: {error.strerror}") from error
        found = content.get("calibration")
        unknown = set(found) - set(Calibrations.model_fields) if isinstance(found, dict) else set()
        if unknown or not found or not isinstance(found, dict):
            raise BAD_OBSERVATIONS(
                f"{file} has no calibration records",
                expected=f"[calibration.{'|'.join(Calibrations.model_fields)}]",
                got=", ".join(sorted(unknown)) or "none",
            )


def read_finished_figures(folder: Path) -> RecordFigures:
    """Return the figures of a finished calibration. Raises CAL-005."""
    try:
        figures = read_figures(folder)
    except (OSError, ValueError) as error:
        raise BAD_OBSERVATIONS(f"cannot read {folder / RESULT_FILE}: {error}") from error
    if not isinstance(figures, RecordFigures):
        raise BAD_OBSERVATIONS(f"cannot read {folder / RESULT_FILE}: it is not of a calibration")
    return figures


def update_theatre(
    theatre: Path, records: dict[str, Any], measured: datetime, signature: UpdateAuthor
) -> None:
    """Put new calibration records into a theatre file, in place.

    A record that was only moved, not `measured` then, keeps its dates. Records of tools stay as they are: a
    person must say that a tool's gauge still fits its new tip.
    """
    former = read_toml(theatre, BadTheatreFile).get("calibration", {})
    dated = {
        name: record if record["created"] == measured else _keep_former_date(former.get(name, {}), record)
        for name, record in records.items()
    }
    update_tables(theatre, {"calibration": dated}, signature)
    tip = records.get("tool_tip", {}).get("identifier")
    for name, tool in read_toml(theatre, BadTheatreFile).get("tools", {}).items():
        if tip is not None and tool.get("tip", tip) != tip:
            terminal.tell(
                f"record {tool['identifier']} refers to the former tip, so no case can start with it: "
                f"read the gauge with this {name}, then ronna-tool renew {name} "
                f"--config {shlex.quote(str(theatre))} --by 'YOUR NAME' --gauge-mm FILE"
            )


def _keep_former_date(former: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    if former.get("identifier") != record["identifier"]:
        return record
    return {**record, "created": former["created"], "expires": former["expires"]}
