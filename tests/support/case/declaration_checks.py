"""What every step must declare: fields described, units in names, results read that are there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel

from procedures.engine.order import Steps
from procedures.journal.results import StepResult

UNITS = ("_mm", "_mm2", "_mm_s", "_rad", "_deg", "_s", "_us", "_px", "_px2", "_nats", "_wxyz", "_kg", "_N")
WITHOUT_UNIT = {
    *("axes", "at", "largest_joint_speed_share"),  # directions, shares
    *("quality", "odds", "confidence", "rim_fraction", "distortion", "widening"),
    *("refused_share", "share", "bone_agreement"),  # the latter a correlation
    "freedom",  # of an estimate: a number
    *("master_errors", "assistant_errors"),  # in standard deviations
    "remaining",  # of an arm's record: a covariance of mm and rad
    *("strain", "covariance", "chi_square", "limit"),  # of a scan's deformation: ratios
    "assumed_robot_from_ct",  # of place.json: X Y Z A B C, mm and deg in one
}


def reading_too_early(steps: Steps) -> list[str]:
    """The steps that read what no earlier step leaves."""
    earlier: set[type[StepResult]] = set()
    early = []
    for step in steps:
        if not set(step.reads) <= earlier:
            early.append(step.name)
        earlier.add(step.result)
    return early


def undescribed(model: type[StepResult]) -> list[str]:
    """The fields without a description."""
    return [name for name, field in parts(model) if not field.description]


def without_unit(model: type[StepResult]) -> list[str]:
    """The quantities whose names do not end with their unit."""
    numbers = [name for name, field in parts(model) if float in leaves(field.annotation)]
    named = [name for name in numbers if name.partition(".")[2] not in WITHOUT_UNIT]
    return [name for name in named if not name.endswith(UNITS)]


def parts(model: type[BaseModel]) -> Iterator[tuple[str, Any]]:
    """Every field of a model and of the models in it, as `Model.field`, with its definition."""
    for name, field in model.model_fields.items():
        yield f"{model.__name__}.{name}", field
        for kind in leaves(field.annotation):
            if issubclass(kind, BaseModel):
                yield from parts(kind)


def leaves(annotation: Any) -> Iterator[type]:
    """The plain types that an annotation is made of."""
    inner = get_args(annotation)
    if not inner and isinstance(annotation, type):
        yield annotation
    for one in inner:
        yield from leaves(one)
