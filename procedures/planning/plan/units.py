"""Values typical of a plan in metres or centimetres, unusable in any case.

Looked for in a file and in the planner, not in a record, which must stay readable.
"""

from __future__ import annotations

from procedures.planning.errors import PlanMistakes
from procedures.planning.head.metres import NOT_METRES, in_metres, span
from procedures.planning.head.structures import LEAST_MARGIN_MM, Structure
from procedures.planning.plan.model import Plan

LEAST_GAP_MM = 1.0  # between skin and guide; 0 is a guide that touches it
LEAST_TARGET_MARGIN_MM = 0.05  # a third of the smallest predicted error


def in_another_unit(plan: Plan) -> list[PlanMistakes]:
    """One mistake for each such value of a plan."""
    found = [
        PlanMistakes(
            f"trajectory {one.id}.margin_mm: {one.margin_mm:g} mm is less than any case can achieve: "
            f"{NOT_METRES}, and at least {LEAST_TARGET_MARGIN_MM:g}"
        )
        for one in plan.trajectories
        if one.margin_mm < LEAST_TARGET_MARGIN_MM
    ]
    found += [mistake for one in plan.structures or () for mistake in structure_in_another_unit(one)]
    if 0.0 < plan.standoff_mm < LEAST_GAP_MM:
        found.append(
            PlanMistakes(f"standoff_mm: {plan.standoff_mm:g} mm is closer than a guide is held: {NOT_METRES}")
        )
    deepest = max(plan.trajectories, key=lambda one: one.depth_mm)
    needed_mm = deepest.depth_mm + plan.standoff_mm
    if plan.instrument_length_mm < needed_mm:
        found.append(
            PlanMistakes(
                f"instrument_length_mm is {plan.instrument_length_mm:g}, but {deepest.id} needs more than "
                f"{needed_mm:.1f} mm: {deepest.depth_mm:.1f} mm from entry to target, {plan.standoff_mm:g} "
                "mm of stand-off, and the guide; give millimetres, not centimetres"
            )
        )
    return found


def structure_in_another_unit(structure: Structure) -> list[PlanMistakes]:
    """The same for one structure."""
    found = []
    if structure.margin_mm < LEAST_MARGIN_MM:
        found.append(
            PlanMistakes(
                f"structure {structure.name}.margin_mm: {structure.margin_mm:g} mm is less than half the "
                f"thickness of any instrument: {NOT_METRES}, and at least {LEAST_MARGIN_MM:g}"
            )
        )
    if in_metres(structure.points_mm):
        found.append(
            PlanMistakes(
                f"structure {structure.name}.points_mm: all within {span(structure.points_mm):.3g} mm of "
                f"each other: {NOT_METRES}"
            )
        )
    return found
