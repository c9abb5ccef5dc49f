"""The structures of a draft: drawn with the mouse, imported, given margins. Each change is a new draft."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from pydantic import ValidationError

from console.planning.draft import Draft
from procedures.imaging.volume import VoxelGeometry
from procedures.planning.errors import PlanMistakes, raise_together
from procedures.planning.plan_file import structure_in_another_unit
from procedures.planning.plan_model import MOST_POINTS_TOGETHER, MOST_STRUCTURES, Structure
from procedures.planning.structures import read_structure, structure_of
from procedures.strategies.trajectory import Point
from ronna_hw.config import describe_mistakes

STEP_MM = 1.0  # between two points of a stroke
USUAL_MARGIN_MM = 3.0  # to a vessel


def drawn(draft: Draft, name: str, place_mm: Point, start_mm: Point | None) -> Draft:
    """With a stroke from `start_mm`, or its first point, on the structure with that name; raises PLAN-002."""
    steps = 1 if start_mm is None else max(1, math.ceil(math.dist(start_mm, place_mm) / STEP_MM))
    points = np.linspace(place_mm if start_mm is None else start_mm, place_mm, steps + 1)[1:]
    known, within_mm, margin_mm = draft.structure(name), 0.0, USUAL_MARGIN_MM
    if known is not None:
        points = np.concatenate([np.array(known.points_mm), points])
        within_mm, margin_mm = known.within_mm, known.margin_mm
    with _mistakes_as_refusals():
        return _bounded(draft.with_structure(structure_of(name, margin_mm, points, within_mm)))


def imported(draft: Draft, name: str, content: bytes, file_name: str, geometry: VoxelGeometry) -> Draft:
    """With a new structure from a file of points. Raises PLAN-002, PLAN-006, PLAN-028."""
    if draft.structure(name) is not None:
        raise PlanMistakes(f"a structure named {name} already exists", action="Enter another name first.")
    with _mistakes_as_refusals():
        return _bounded(
            draft.with_structure(read_structure(content, file_name, name, USUAL_MARGIN_MM, geometry))
        )


def with_margin(draft: Draft, name: str, margin_mm: float) -> Draft:
    """With this margin to a structure. Raises PLAN-002."""
    known = draft.structure(name)
    if known is None:
        return draft
    with _mistakes_as_refusals():
        changed = Structure.model_validate(known.model_copy(update={"margin_mm": margin_mm}).model_dump())
    raise_together(structure_in_another_unit(changed), "the structure")
    return draft.with_structure(changed)


def free_name(draft: Draft) -> str:
    """A name for one more structure."""
    return next(name for k in range(1, MOST_STRUCTURES + 2) if draft.structure(name := f"S{k}") is None)


def _bounded(draft: Draft) -> Draft:
    if len(draft.structures) > MOST_STRUCTURES:
        raise PlanMistakes("too many structures", limit=f"{MOST_STRUCTURES}")
    points = sum(len(one.points_mm) for one in draft.structures)
    if points > MOST_POINTS_TOGETHER:
        raise PlanMistakes("too many structure points", limit=f"{MOST_POINTS_TOGETHER}", got=f"{points}")
    return draft


@contextmanager
def _mistakes_as_refusals() -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise PlanMistakes("; ".join(describe_mistakes(error))) from error
