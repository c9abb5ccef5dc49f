"""Files for a marker template: the head it is made for, and the template itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, ValidationError

from procedures.planning.errors import HeadUnreadable, WrongSeries
from procedures.planning.head.shape import HeadEllipsoid
from procedures.planning.plan.model import Plan
from ronna_hw.bounded_input import read_toml
from ronna_hw.calibration import Strict
from ronna_hw.marker_template import MarkerTemplate
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import write_whole

Place = Annotated[float, Field(ge=-5000.0, le=5000.0)]  # mm: markers on the head are within a plan's bounds
Axis = Annotated[float, Field(gt=0.0, le=1000.0)]  # mm


class _Target(Strict):
    model_config = ConfigDict(extra="ignore")

    target_ct_mm: tuple[Place, Place, Place]


class _Head(Strict):
    """What is needed from a scene; the rest is the simulator's."""

    model_config = ConfigDict(extra="ignore")

    centre_ct_mm: tuple[Place, Place, Place]
    semi_axes_mm: tuple[Axis, Axis, Axis]
    targets: tuple[_Target, ...] = ()


def head_of_scene(path: Path, plan: Plan | None = None) -> HeadEllipsoid:
    """The head's ellipsoid from a scene file. Raises PLAN-016; PLAN-003 if none of its targets is planned."""
    try:
        head = read_toml(path, HeadUnreadable).get("head")
    except OSError as error:
        raise HeadUnreadable(f"cannot read {path}: {error.strerror}") from error
    try:
        found = _Head.model_validate_json(json.dumps(head, default=str))
    except ValidationError as error:
        raise HeadUnreadable(f"{path.name}, [head]: " + "; ".join(describe_mistakes(error))) from error
    there = {one.target_ct_mm for one in found.targets}
    if plan is not None and there and there.isdisjoint(one.target_mm for one in plan.trajectories):
        raise WrongSeries(
            f"{path.name} has none of the plan's targets: it is the scene of another head",
            action="Give the scene that the plan was made with, or the CT it was planned on (--ct).",
        )
    return HeadEllipsoid(centre_mm=found.centre_ct_mm, semi_axes_mm=found.semi_axes_mm)


def write_template(path: Path, template: MarkerTemplate) -> None:
    """Write it as TOML."""
    import tomli_w

    write_whole(path, tomli_w.dumps(template.model_dump(mode="json", by_alias=True)).encode())
