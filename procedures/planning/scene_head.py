"""Head and its pose from a simulator scene file: what `ronna-sim scene` or a simulated theatre wrote."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, ValidationError

from procedures.planning.errors import HEAD_UNREADABLE, WRONG_SERIES
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.plan_model import Plan
from ronna_hw.bounded_input import InputRefused, read_json_bytes, read_toml
from ronna_hw.calibration import PoseRecord, Strict
from ronna_hw.mistakes import describe_mistakes, find_other_kind

Place = Annotated[float, Field(ge=-5000.0, le=5000.0)]  # mm: within a plan's bounds
Axis = Annotated[float, Field(gt=0.0, le=1000.0)]  # mm


class _Target(Strict):
    model_config = ConfigDict(extra="ignore")

    target_ct_mm: tuple[Place, Place, Place]


class _Head(Strict):
    """`[head]` table of a scene file. Other keys are ignored."""

    model_config = ConfigDict(extra="ignore")

    centre_ct_mm: tuple[Place, Place, Place]
    semi_axes_mm: tuple[Axis, Axis, Axis]
    robot_from_ct: PoseRecord | None = None
    targets: tuple[_Target, ...] = ()


def read_scene_head(path: Path, plan: Plan | None = None) -> HeadEllipsoid:
    """Read the head ellipsoid from a scene file. Raises PLAN-016, or PLAN-003 if it has no planned target."""
    found = _read_head(path, plan)
    return HeadEllipsoid(centre_mm=found.centre_ct_mm, semi_axes_mm=found.semi_axes_mm)


def read_scene_pose(path: Path, plan: Plan) -> PoseRecord:
    """Read the pose robot <- CT from a scene file. Raises PLAN-016, PLAN-003 like `read_scene_head`."""
    found = _read_head(path, plan).robot_from_ct
    if found is None:
        raise HEAD_UNREADABLE(f"{path.name} has no head.robot_from_ct")
    return found


def _read_head(path: Path, plan: Plan | None) -> _Head:
    try:
        table = _read_table(path)
        if kind := find_other_kind(table, "head"):
            raise HEAD_UNREADABLE(f"{path} is {kind}, not a scene", expected="a table [head]")
        found = _Head.model_validate_json(json.dumps(table.get("head"), default=str))
    except OSError as error:
        raise HEAD_UNREADABLE(f"cannot read {path}: {error.strerror}") from error
    except ValidationError as error:
        raise HEAD_UNREADABLE(f"{path.name}, [head]: " + "; ".join(describe_mistakes(error))) from error
    targets = {one.target_ct_mm for one in found.targets}
    if plan is not None and targets and targets.isdisjoint(one.target_mm for one in plan.trajectories):
        raise WRONG_SERIES(
            f"{path.name} has none of the plan's targets: it is the scene of another head",
            action="Give the scene that the plan was made with, or the CT it was planned on (--ct).",
        )
    return found


def _read_table(path: Path) -> dict[str, object]:
    """Return the content of a TOML or JSON scene file. Raises PLAN-016, OSError."""
    if path.suffix != ".json":
        return read_toml(path, HEAD_UNREADABLE)
    try:
        content = json.loads(read_json_bytes(path))
    except InputRefused as error:
        raise HEAD_UNREADABLE(f"{path.name} is refused: {error.summary}") from error
    except ValueError as error:
        raise HEAD_UNREADABLE(f"{path.name} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise HEAD_UNREADABLE(f"{path.name} is not a table")
    return content
