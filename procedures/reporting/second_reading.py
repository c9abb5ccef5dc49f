"""Independent cross-check of the target figures, read from plain JSON and printed as plain text.

It shares neither models nor formatter with the report's table, so that a number wrong in either shows up as a
difference. Rows are (target, depth, predicted, largest at its confidence, error) as text.
"""

from __future__ import annotations

import json
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input import check_json, read_json_bytes, read_json_lines
from ronna_hw.text import printable

HEADINGS = ("target", "depth mm", "predicted mm rms", "predicted limit mm", "error mm")
NOTHING = "–"  # unknown
UNREADABLE = (OSError, ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError)

Row = tuple[str, ...]


def second_reading(run: Path, truth_file: Path) -> tuple[Row, ...]:
    """Read the target rows from the record files, and from the truth file if it exists.

    Files unlike those a run leaves raise one of `UNREADABLE`.
    """
    journal = [
        json.loads(check_json(line).decode()) for line in read_json_lines(run / "journal.jsonl").splitlines()
    ]
    results = [line for line in journal if line["entry"] == "result"]
    gone = {name for line in journal for name in line.get("supersedes", ())}
    names = [line["record"] for line in results]
    made = {name: json.loads(read_json_bytes(run / "records" / f"{name}.json")) for name in names}
    standing = {name: record for name, record in made.items() if name not in gone}
    depth_mm = _depths(list(standing.values()))
    used = _registrations(made, standing)
    errors_mm: dict[str, float] = {}
    if truth_file.exists():
        truth = json.loads(read_json_bytes(truth_file))
        errors_mm = {one["id"]: one["application_error_mm"] for one in truth["targets"]}
    return tuple(
        (
            one["target"],
            _round_decimal(depth_mm.get(one["target"]), "0.1"),
            _round_decimal(one["rms_mm"], "0.001"),
            _round_decimal(one["limit_mm"], "0.001"),
            _round_decimal(errors_mm.get(one["target"]), "0.001"),
        )
        for name, record in made.items()
        if record["kind"] == "registration"
        for one in record["payload"]["predictions"]
        if used.get(one["target"]) == name
    )


def as_text(rows: tuple[Row, ...]) -> str:
    """Format the rows as columns with headings. Raises like `second_reading`."""
    table = [HEADINGS, *(tuple(map(printable, row)) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(HEADINGS))]
    return "".join(
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) + "\n" for row in table
    )


def _registrations(made: dict[str, Any], standing: dict[str, Any]) -> dict[str, str]:
    """Map each target to its valid registration, or if already reached, to the one used to reach it."""
    used = {
        one["target"]: name
        for name, record in standing.items()
        if record["kind"] == "registration"
        for one in record["payload"]["predictions"]
    }
    for record in standing.values():
        if record["kind"] == "at_target":
            (positioned,) = (name for name in record["parents"] if made[name]["kind"] == "positioning")
            (registration_name,) = (
                name for name in made[positioned]["parents"] if made[name]["kind"] == "registration"
            )
            used[record["trajectory"]] = registration_name
    return used


def _depths(records: list[dict[str, Any]]) -> dict[str, float]:
    for record in records:
        if record["kind"] == "plan_check":
            return {
                one["id"]: sum((a - b) ** 2 for a, b in zip(one["entry_mm"], one["target_mm"], strict=True))
                ** 0.5
                for one in record["payload"]["plan"]["trajectories"]
            }
    return {}


def _round_decimal(value: float | None, step: str) -> str:
    if value is None:
        return NOTHING
    return str(Decimal(value).quantize(Decimal(step), rounding=ROUND_HALF_EVEN))
