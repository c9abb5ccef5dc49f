"""Comparison of the plan with the postoperative CT, trajectory by trajectory.

Instruments and holes found near the trajectories are assigned to them, at most one each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from pydantic import Field
from scipy.optimize import linear_sum_assignment

from procedures.imaging.volume import Volume
from procedures.planning.errors import WRONG_SERIES
from procedures.planning.plan_model import Plan, PlannedTrajectory
from procedures.postoperative.bone_registration import BoneRegistration, register_on_bone
from procedures.postoperative.drill_hole import USUAL_HOLE, find_holes
from procedures.postoperative.errors import (
    FIT_FAILED,
    INSTRUMENT_AMBIGUOUS,
    INSTRUMENT_MISSING,
    ONE_SERIES_TWICE,
    SERIES_SWAPPED,
)
from procedures.postoperative.instrument import USUAL_ROD, find_rods
from procedures.postoperative.planned_line import SEARCH_MM, PlannedLine
from procedures.strategies.trajectory import split_along
from ronna_hw.arrays import Array
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.vectors import vector3

ONE_INSTRUMENT_MM = 1.5  # axes closer than this are one instrument; electrodes are wider
# A hole counts only if no instrument is left, a failed fit only after both.
SUBSTITUTE_PENALTY_MM = 10.0 * SEARCH_MM
NOTHING_MM = 1e6  # and none only if nothing is left


class FoundKind(StrEnum):
    """Kind of object found along a trajectory."""

    INSTRUMENT = "instrument"  # an electrode or a needle: a rod of metal
    DRILL_HOLE = "drill hole"


class FoundTrajectory(Strict):
    """Trajectory as planned and as found, with points in LPS mm of the planning CT.

    A hole has no tip: `tip_mm`, `target_error_mm` and `depth_error_mm` are None; `lateral_mm` is that of its
    axis.
    """

    id: str = Field(description="Its name in the plan.")
    kind: FoundKind = Field(description="An instrument, with a tip, or a drilled hole, without.")
    planned_entry_mm: Numbers3 = Field(description="Planned point.")
    planned_target_mm: Numbers3 = Field(description="Planned point.")
    entry_mm: Numbers3 = Field(description="Point of the found axis at the planned entry.")
    axis_at_target_mm: Numbers3 = Field(description="The tip, or the point of a hole's axis at the target.")
    tip_mm: Numbers3 | None = Field(description="Tip of the instrument.")
    entry_error_mm: float = Field(
        description="From the planned entry to the axis, across the planned trajectory."
    )
    target_error_mm: float | None = Field(description="From the planned target to the tip.")
    lateral_mm: float = Field(description="At the target, across the planned trajectory.")
    depth_error_mm: float | None = Field(description="Along the planned trajectory; positive is too deep.")
    angle_deg: float = Field(description="Between the planned and the found axis.")
    doubts: tuple[str, ...] = Field(default=(), description="Reasons, from its fit, why it may be wrong.")


@dataclass(frozen=True, eq=False)
class PostoperativeComparison:
    """Registration of both scans, and the findings for all requested trajectories."""

    registration: BoneRegistration
    trajectories: tuple[FoundTrajectory, ...]


def compare_with_plan(
    plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()
) -> PostoperativeComparison:
    """Find the object along each trajectory of a plan, or along those listed in `only`.

    Raises PLAN-003, POST-001 to POST-004, POST-006, POST-007, POST-009.
    """
    require_series(plan, pre, post)
    return compare_registered(register_on_bone(pre, post), plan, pre, post, only)


def compare_registered(
    registration: BoneRegistration, plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()
) -> PostoperativeComparison:
    """Find the objects along the trajectories after registration. Raises POST-006, POST-007, POST-009."""
    chosen = [one for one in plan.trajectories if not only or one.id in only]
    lines = {one.id: PlannedLine(np.array(one.entry_mm), np.array(one.target_mm)) for one in chosen}
    candidates = {name: _candidates(line, pre, post, registration) for name, line in lines.items()}
    found, lost_to = assign(lines, candidates)
    if lost_to:
        pairs = ", ".join(f"{name} and {other}" for name, other in lost_to.items())
        raise INSTRUMENT_AMBIGUOUS(f"the same instrument or hole was found along {pairs}")
    if missing := [name for name in lines if name not in found]:
        raise INSTRUMENT_MISSING(
            f"neither an instrument nor a drilled hole was found along {', '.join(missing)}",
            expected=f"one along each of {len(chosen)}",
            got=f"found along {', '.join(found)}" if found else "none",
        )
    if failed := [
        f"{name} ({one.kind}: {'; '.join(one.failures)})" for name, one in found.items() if one.failures
    ]:
        raise FIT_FAILED(
            f"no straight rod or round hole could be fitted to the object along {', '.join(failed)}"
        )
    compared = (_compare_trajectory(one, lines[one.id], found[one.id]) for one in chosen)
    return PostoperativeComparison(registration, tuple(compared))


def require_series(plan: Plan, pre: Volume, post: Volume) -> None:
    """Require `pre` to be the plan's series and `post` another. Raises PLAN-003, POST-003, POST-004."""
    if pre.series_instance_uid == post.series_instance_uid:
        raise ONE_SERIES_TWICE("both CTs are the same series", got=pre.series_instance_uid)
    if plan.series_instance_uid == pre.series_instance_uid:
        return
    if plan.series_instance_uid == post.series_instance_uid:
        raise SERIES_SWAPPED("the plan was made on the second CT: the two are swapped")
    words = "the plan belongs to another CT series"
    raise WRONG_SERIES(words, expected=plan.series_instance_uid, got=pre.series_instance_uid)


def _candidates(
    line: PlannedLine, pre: Volume, post: Volume, registration: BoneRegistration
) -> tuple[InstrumentCandidate, ...]:
    """Find rods and holes near a planned trajectory, in planning CT coordinates."""
    pose = registration.post_from_pre
    back = pose.inv()
    kinds = (
        (FoundKind.INSTRUMENT, find_rods(pre, post, line, pose), USUAL_ROD),
        (FoundKind.DRILL_HOLE, find_holes(pre, post, line, pose), USUAL_HOLE),
    )
    return tuple(
        InstrumentCandidate(
            kind,
            back.apply(one.point_mm),
            -back.rotation.apply(one.outwards),
            one.quality.failures,
            usual.doubts(one.quality),
        )
        for kind, found, usual in kinds
        for one in found
    )


def _compare_trajectory(
    planned: PlannedTrajectory, line: PlannedLine, found: InstrumentCandidate
) -> FoundTrajectory:
    """Measure the deviation of an instrument or hole from its planned trajectory."""
    along, point_mm, inwards = line.inwards, found.point_mm, found.inwards
    entry, at_target = (
        point_mm + inwards * (float((place - point_mm) @ along) / float(inwards @ along))
        for place in (line.entry_mm, line.target_mm)
    )
    has_tip = found.kind is FoundKind.INSTRUMENT
    if has_tip:
        at_target = point_mm
    off = at_target - line.target_mm
    lateral_mm, depth_mm = split_along(off, along)
    angle_rad = np.arctan2(np.linalg.norm(np.cross(inwards, along)), inwards @ along)
    return FoundTrajectory(
        id=planned.id,
        kind=found.kind,
        planned_entry_mm=planned.entry_mm,
        planned_target_mm=planned.target_mm,
        entry_mm=vector3(entry),
        axis_at_target_mm=vector3(at_target),
        tip_mm=vector3(point_mm) if has_tip else None,
        entry_error_mm=float(np.linalg.norm(entry - line.entry_mm)),
        target_error_mm=float(np.linalg.norm(off)) if has_tip else None,
        lateral_mm=lateral_mm,
        depth_error_mm=depth_mm if has_tip else None,
        angle_deg=float(np.degrees(angle_rad)),
        doubts=found.doubts,
    )


@dataclass(frozen=True, eq=False)
class InstrumentCandidate:
    """Rod or hole in planning CT coordinates: tip or point in the bone, (3,) mm, and axis.

    `failures` are reasons why it cannot be used at all, `doubts` why it may be wrong.
    """

    kind: FoundKind
    point_mm: Array
    inwards: Array
    failures: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def axis_distance_mm(self, point_mm: Array) -> float:
        """Return the distance of the axis from a point (3,), in mm."""
        return split_along(point_mm - self.point_mm, self.inwards)[0]

    def is_same_object(self, other: InstrumentCandidate) -> bool:
        """Return whether two candidates are the same instrument or hole, or an instrument in its hole."""
        if self.kind is other.kind is FoundKind.DRILL_HOLE:
            return float(np.linalg.norm(self.point_mm - other.point_mm)) < ONE_INSTRUMENT_MM
        near = (  # a hole's direction is too uncertain to extrapolate to a tip
            one.axis_distance_mm(another.point_mm) < ONE_INSTRUMENT_MM
            for one, another in ((self, other), (other, self))
            if one.kind is FoundKind.INSTRUMENT
        )
        return all(near)


def assign(
    lines: Mapping[str, PlannedLine], candidates: Mapping[str, Sequence[InstrumentCandidate]]
) -> tuple[dict[str, InstrumentCandidate], dict[str, str]]:
    """Assign candidates to trajectories by smallest total distance, and report who won a contested one.

    `lines` are the planned ones, `candidates` those found along each; both by name.
    """
    names = list(lines)
    found_objects: list[InstrumentCandidate] = []
    nearest: dict[tuple[int, int], tuple[float, InstrumentCandidate]] = {}  # by trajectory and candidate
    for row, name in enumerate(names):
        for one in candidates[name]:
            number = next(
                (k for k, thing in enumerate(found_objects) if thing.is_same_object(one)), len(found_objects)
            )
            if number == len(found_objects):
                found_objects.append(one)
            cost_mm = _assignment_cost_mm(lines[name], one)
            if cost_mm < nearest.get((row, number), (NOTHING_MM, one))[0]:
                nearest[row, number] = cost_mm, one
    costs_mm = np.full((len(names), len(found_objects) + len(names)), NOTHING_MM)
    for place, (cost_mm, _) in nearest.items():
        costs_mm[place] = cost_mm
    pairs = zip(*(indices.tolist() for indices in linear_sum_assignment(costs_mm)), strict=True)
    taken = {number: row for row, number in pairs if (row, number) in nearest}
    found = {names[row]: nearest[row, number][1] for number, row in taken.items()}
    lost_to = {names[row]: names[taken[number]] for row, number in nearest if names[row] not in found}
    return found, lost_to


def _assignment_cost_mm(line: PlannedLine, one: InstrumentCandidate) -> float:
    """Return the axis's mean distance from entry and target, plus a penalty for holes and failed fits."""
    mean_mm = 0.5 * (one.axis_distance_mm(line.entry_mm) + one.axis_distance_mm(line.target_mm))
    rank = (one.kind is FoundKind.DRILL_HOLE) + 2 * bool(one.failures)
    return mean_mm + rank * SUBSTITUTE_PENALTY_MM
