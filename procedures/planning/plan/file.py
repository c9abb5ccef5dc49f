"""Reads and writes `plan.toml`. All mistakes in a file are reported at once."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from procedures.planning.errors import (
    BadTrajectoryGeometry,
    DuplicateTrajectory,
    PlanError,
    PlanMistakes,
    PlanNotSaved,
    PlanUnreadable,
    raise_together,
)
from procedures.planning.plan.model import Plan
from procedures.planning.plan.seal import require_unaltered
from procedures.planning.plan.units import in_another_unit
from ronna_hw.bounded_input import read_toml, toml_of
from ronna_hw.mistakes import describe_mistakes, mistakes_in
from ronna_hw.records import write_whole
from ronna_hw.text import printable

# What an item of a list is called, and the key with its name.
NAMED = {"trajectories": ("trajectory", "id"), "structures": ("structure", "name")}
# What plans of earlier versions lack, and what to write.
ADDED = {
    "standoff_mm": "add `standoff_mm = 30.0`: from the entry to the lower end of the guide, outside the skin",
    "instrument_length_mm": "add `instrument_length_mm = 250.0`: its length from the tip to the end that "
    "still holds a depth stop, as on its packaging",
}


def read_plan(path: Path, *, sealed_only: bool = True) -> Plan:
    """Read and check a plan. Raises PLAN-001 and the errors of `parse_plan`, listing every mistake."""
    path = Path(path)
    try:
        content = read_toml(path, PlanUnreadable)
    except OSError as error:
        raise PlanUnreadable(f"cannot read {path}: {error.strerror}") from error
    return parse_plan(content, path.name, sealed_only=sealed_only)


def plan_of(content: bytes, name: str) -> Plan:
    """The plan in the content of a file with this name. Raises like `read_plan`."""
    return parse_plan(toml_of(content, name, PlanUnreadable), name)


def parse_plan(content: dict[str, Any], name: str = "the plan", *, sealed_only: bool = True) -> Plan:
    """Check the content of a plan. Raises PLAN-002, PLAN-004, PLAN-005, PLAN-023, listing every mistake.

    Without `sealed_only`, a plan altered since it was sealed is still read, for viewing.
    """
    if "theatre" in content and "trajectories" not in content:
        raise PlanUnreadable(f"{name} is a theatre file, not a plan", action="Give the path of a plan.toml.")
    found: list[PlanError] = []
    plan: Plan | None = None
    try:
        # TOML has lists where the model has tuples, text where it has enums; strict JSON mode accepts both.
        plan = Plan.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        lines = describe_mistakes(error, Plan)
        for mistake, line in zip(mistakes_in(error), lines, strict=False):
            kind = BadTrajectoryGeometry if mistake["type"] == "trajectory_geometry" else PlanMistakes
            message = _named(line, mistake["loc"], content) + _to_add(mistake)
            found.append(kind(message))
    found += [
        DuplicateTrajectory(f"{count} trajectories have the id {identifier!r}")
        for identifier, count in _ids(content).items()
        if count > 1
    ]
    found += [] if plan is None else in_another_unit(plan)
    if len(found) == 1:
        raise type(found[0])(f"{name}: {found[0].what}")
    raise_together(found, name)
    if plan is None:
        raise PlanMistakes(f"{name} is not a plan")
    if sealed_only:
        require_unaltered(plan, name)
    return plan


def write_plan(path: Path, plan: Plan, notes: Iterable[str] = ()) -> None:
    """Write a plan atomically, with `notes` as comments above it. Raises PLAN-025."""
    import tomli_w

    head = "".join(f"# {printable(line)}\n" for line in notes)
    content = plan.model_dump(mode="json", by_alias=True, exclude_none=True)
    try:
        write_whole(path, (head + tomli_w.dumps(content)).encode())
    except OSError as error:
        raise PlanNotSaved(f"cannot write {path.name}: {error.strerror}") from error


def _named(line: str, place: tuple[int | str, ...], content: dict[str, Any]) -> str:
    """The line naming the trajectory or the structure, if it has a name; otherwise by its number."""
    match place:
        case ("trajectories" | "structures" as table, int(index), *_):
            kind, key = NAMED[table]
            row = content[table][index]
            name = row.get(key) if isinstance(row, dict) else None
            known = f"{kind} {printable(name)}" if isinstance(name, str) and name else f"{kind} {index + 1}"
            return line.replace(f"{table} {index + 1}", known, 1)
    return line


def _to_add(mistake: Mapping[str, Any]) -> str:
    key = str(mistake["loc"][-1]) if mistake["loc"] else ""
    return f"; {ADDED[key]}" if mistake["type"] == "missing" and key in ADDED else ""


def _ids(content: dict[str, Any]) -> Counter[str]:
    """How often each id occurs; uses the raw content, as other mistakes may prevent parsing the model."""
    rows = content.get("trajectories")
    if not isinstance(rows, list):
        return Counter()
    return Counter(row["id"] for row in rows if isinstance(row, dict) and isinstance(row.get("id"), str))
