"""Files written by a calibration: records, figures and an updated theatre file.

OUT/<id>/calibration.toml    the new records, to put into the theatre file
OUT/<id>/result.json         the output of `--json`
"""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from procedures.calibration.errors import BadObservations
from procedures.reporting.calibration_figures import RESULT_FILE, RecordFigures, read_figures
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, parse_toml_bytes, read_bounded, read_toml
from ronna_hw.command_line import terminal
from ronna_hw.config import BadTheatreFile, Calibrations
from ronna_hw.records import write_atomically

TablePath = tuple[str, ...]  # of a table: `calibration`, `tool_tip`
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
            content = read_toml(file, BadObservations)
        except OSError as error:
            raise BadObservations(f"cannot read {file}: {error.strerror}") from error
        found = content.get("calibration")
        unknown = set(found) - set(Calibrations.model_fields) if isinstance(found, dict) else set()
        if unknown or not found or not isinstance(found, dict):
            raise BadObservations(
                f"{file} has no calibration records",
                expected=f"[calibration.{'|'.join(Calibrations.model_fields)}]",
                got=", ".join(sorted(unknown)) or "none",
            )


def read_finished_figures(folder: Path) -> RecordFigures:
    """Return the figures of a finished calibration. Raises CAL-005."""
    try:
        figures = read_figures(folder)
    except (OSError, ValueError) as error:
        raise BadObservations(f"cannot read {folder / RESULT_FILE}: {error}") from error
    if not isinstance(figures, RecordFigures):
        raise BadObservations(f"cannot read {folder / RESULT_FILE}: it is not of a calibration")
    return figures


def write_theatre(source: Path, target: Path, records: dict[str, Any], measured: datetime) -> None:
    """Copy the theatre file `source` to `target` with new calibration records, keeping the comments.

    A record that was only moved, not `measured` then, keeps its dates from `source`. Records of tools stay
    as they are: a person must say that a tool's gauge still fits its new tip.
    """
    former = read_toml(source, BadTheatreFile).get("calibration", {})
    dated = {
        name: record if record["created"] == measured else _keep_former_date(former.get(name, {}), record)
        for name, record in records.items()
    }
    write_theatre_tables(source, target, {"calibration": dated})
    tip = records.get("tool_tip", {}).get("identifier")
    for name, tool in read_toml(target, BadTheatreFile).get("tools", {}).items():
        if tip is not None and tool.get("tip", tip) != tip:
            terminal.tell(
                f"record {tool['identifier']} refers to the former tip, so no case can start with it: "
                f"read the gauge with this {name}, then ronna-tool renew {name} "
                f"--config {shlex.quote(str(target))} "
                "--write FILE --by NAME --gauge-mm FILE"
            )


def write_theatre_tables(source: Path, target: Path, tables: dict[str, dict[str, Any]]) -> None:
    """Copy the theatre file `source` to `target` with new entries in its tables, keeping the comments."""
    require_same_folder(source, target)
    content = read_bounded(source, LARGEST_TOML_BYTES)
    parse_toml_bytes(content, source.name, BadTheatreFile)
    text = content.decode("utf-8-sig").replace("\r\n", "\n")
    write_atomically(target, with_tables(text, tables).encode())


def require_same_folder(source: Path, target: Path) -> None:
    """Raise CAL-005 unless `target` is in the same folder as the theatre file `source`."""
    if target.resolve().parent != source.resolve().parent:
        raise BadObservations(
            f"{target} is not in the folder of {source.name}, which its relative paths refer to",
            action="Name a file in the folder of the theatre file.",
        )


def _keep_former_date(former: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    if former.get("identifier") != record["identifier"]:
        return record
    return {**record, "created": former["created"], "expires": former["expires"]}


def with_tables(text: str, tables: Mapping[str, Mapping[str, Any]]) -> str:
    """Return TOML text with the table entries replaced, or appended if they are new.

    The outcome is compared with the intended content: if these tables have no headers of their own, comments
    are lost.
    """
    import tomli_w

    intended_content = tomllib.loads(text)
    new: dict[TablePath, str] = {}
    for name, entries in tables.items():
        intended_content[name] = {**intended_content.get(name, {}), **entries}
        new |= {(name, key): tomli_w.dumps({name: {key: entry}}) for key, entry in entries.items()}
    replaced = "".join(_remove_tables(text, new))
    try:
        kept = tomllib.loads(replaced) == intended_content
    except tomllib.TOMLDecodeError:
        kept = False
    return replaced if kept else tomli_w.dumps(intended_content)


def _remove_tables(text: str, new: dict[TablePath, str]) -> Iterator[str]:
    """Yield the lines of TOML text, replacing existing tables by those in `new` and appending the rest.

    Comments in front of the next header are kept.
    """
    to_write = dict(new)
    skipping, remarks = False, list[str]()
    for line in text.splitlines(keepends=True):
        place = _parse_header(line)
        if place is not None:
            skipping = place[:2] in new
            yield from remarks
            remarks.clear()
            if skipping:
                yield to_write.pop(place[:2], "")
        if not skipping:
            yield line
        elif place is None and (not line.strip() or line.lstrip().startswith("#")):
            remarks.append(line)
        else:
            remarks.clear()  # of the record that is replaced
    yield from remarks
    for table in to_write.values():
        yield f"\n{table}"


def _parse_header(line: str) -> TablePath | None:
    """Parse a TOML table header into the table's path; return None for any other line."""
    if not line.lstrip().startswith("["):
        return None
    try:
        inner: Any = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return None
    place: list[str] = []
    while inner:
        if isinstance(inner, list):
            inner = inner[0]
        else:
            ((name, inner),) = inner.items()
            place.append(name)
    return tuple(place)
