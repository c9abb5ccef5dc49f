"""The figures of the targets, as a report shows them and as a run's files have them.

What is read from the files shares neither models nor formatter with the report, so that a figure wrong in
either shows as a difference. Rows are (target, error, depth, predicted, largest at its confidence) as text.
"""

from __future__ import annotations

import json
import re
from decimal import ROUND_HALF_EVEN, Decimal
from pathlib import Path
from typing import Any

from report_text import report_text

Row = tuple[str, ...]
NOTHING = "–"  # unknown
COLUMNS = 5


def figures_in(report: Path) -> tuple[Row, ...]:
    """The figures of each target on the page."""
    detail = report_text(report).partition("Error at the targets, in detail")[2].partition("</table>")[0]
    rows = (re.findall(r"<td>(.*?)</td>", row) for row in detail.split("<tr>"))
    return tuple(tuple(cells[:COLUMNS]) for cells in rows if cells)


def figures_of_records(run: Path, truth_file: Path | None = None) -> tuple[Row, ...]:
    """The same from journal, records and the verifier's stored result, by default the run's own."""
    truth_file = run / "report" / "truth.json" if truth_file is None else truth_file
    journal = [json.loads(line) for line in (run / "journal.jsonl").read_bytes().splitlines()]
    gone = {name for line in journal for name in line.get("supersedes", ())}
    names = [line["record"] for line in journal if line["entry"] == "result"]
    made = {name: json.loads((run / "records" / f"{name}.json").read_bytes()) for name in names}
    standing = {name: record for name, record in made.items() if name not in gone}
    depth_mm, used = depths_mm(standing), used_registrations(made, standing)
    truth = json.loads(truth_file.read_bytes())["targets"] if truth_file.exists() else []
    error_mm = {one["id"]: one["application_error_mm"] for one in truth}
    return tuple(
        (
            one["target"],
            rounded(error_mm.get(one["target"]), "0.001"),
            rounded(depth_mm.get(one["target"]), "0.1"),
            rounded(one["rms_mm"], "0.001"),
            rounded(one["limit_mm"], "0.001"),
        )
        for name, record in made.items()
        if record["kind"] == "registration"
        for one in record["payload"]["predictions"]
        if used.get(one["target"]) == name
    )


def used_registrations(made: dict[str, Any], standing: dict[str, Any]) -> dict[str, str]:
    """Its valid registration for each target, or for one that was reached, the one that led there."""
    used = {
        one["target"]: name
        for name, record in standing.items()
        if record["kind"] == "registration"
        for one in record["payload"]["predictions"]
    }
    for record in standing.values():
        if record["kind"] == "at_target":
            (positioned,) = (name for name in record["parents"] if made[name]["kind"] == "positioning")
            parents = made[positioned]["parents"]
            (used[record["trajectory"]],) = (name for name in parents if made[name]["kind"] == "registration")
    return used


def depths_mm(standing: dict[str, Any]) -> dict[str, float]:
    """Depth of each planned target below its entry."""
    plans = [record["payload"]["plan"] for record in standing.values() if record["kind"] == "plan_check"]
    return {
        one["id"]: sum((a - b) ** 2 for a, b in zip(one["entry_mm"], one["target_mm"], strict=True)) ** 0.5
        for plan in plans
        for one in plan["trajectories"]
    }


def rounded(value: float | None, step: str) -> str:
    """A number with the decimals of `step`."""
    return NOTHING if value is None else str(Decimal(value).quantize(Decimal(step), ROUND_HALF_EVEN))
