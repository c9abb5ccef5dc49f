"""Reads `plan.toml`. All mistakes of a file are reported at once."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from procedures.planning.errors import (
    BadTrajectoryGeometry,
    DuplicateTrajectory,
    PlanError,
    PlanMistakes,
    PlanUnreadable,
    raise_together,
)
from procedures.planning.plan import Plan
from ronna_hw.bounded_input import read_toml
from ronna_hw.config import describe_mistakes


def read_plan(path: Path) -> Plan:
    """Read and check a plan. Raises PLAN-001, PLAN-002, PLAN-004, PLAN-005 with every mistake in it."""
    path = Path(path)
    try:
        content = read_toml(path, PlanUnreadable)
    except OSError as error:
        raise PlanUnreadable(f"cannot read {path}: {error.strerror}") from error
    return parse_plan(content, path.name)


def parse_plan(content: dict[str, Any], name: str = "the plan") -> Plan:
    """Check the content of a plan. Raises PLAN-002, PLAN-004, PLAN-005 with every mistake in it."""
    found: list[PlanError] = []
    plan: Plan | None = None
    try:
        # TOML has lists where the model has tuples and text where it has words; strict JSON mode takes both.
        plan = Plan.model_validate_json(json.dumps(content, default=str))
    except ValidationError as error:
        lines = describe_mistakes(error, Plan)
        for mistake, line in zip(error.errors(include_url=False), lines, strict=False):
            kind = BadTrajectoryGeometry if mistake["type"] == "trajectory_geometry" else PlanMistakes
            found.append(kind(_named(line, mistake["loc"], content)))
    found += [
        DuplicateTrajectory(f"{count} trajectories have the id {identifier!r}")
        for identifier, count in _ids(content).items()
        if count > 1
    ]
    if len(found) == 1:
        raise type(found[0])(f"{name}: {found[0].what}")
    raise_together(found, name)
    if plan is None:
        raise PlanMistakes(f"{name} is not a plan")
    return plan


def _named(line: str, place: tuple[int | str, ...], content: dict[str, Any]) -> str:
    """The line with the trajectory by its id, where it has one; without, by its number."""
    match place:
        case ("trajectories", int(index), *_):
            row = content["trajectories"][index]
            name = row.get("id") if isinstance(row, dict) else None
            known = f"trajectory {name}" if isinstance(name, str) and name else f"trajectory {index + 1}"
            return line.replace(f"trajectories {index + 1}", known, 1)
    return line


def _ids(content: dict[str, Any]) -> Counter[str]:
    """How often each id occurs; looks at the raw content, because other mistakes may hide the model."""
    rows = content.get("trajectories")
    if not isinstance(rows, list):
        return Counter()
    return Counter(row["id"] for row in rows if isinstance(row, dict) and isinstance(row.get("id"), str))
