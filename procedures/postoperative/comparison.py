"""Compares the plan with what the postoperative CT shows, trajectory by trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import Volume
from procedures.planning.errors import WrongSeries
from procedures.planning.plan_model import Plan
from procedures.postoperative.assignment import Candidate, FoundKind, assigned
from procedures.postoperative.bone_registration import BoneRegistration, register_on_bone
from procedures.postoperative.drill_hole import USUAL_HOLE, find_holes
from procedures.postoperative.errors import (
    FitFailed,
    InstrumentAmbiguous,
    InstrumentMissing,
    OneSeriesTwice,
    SeriesSwapped,
)
from procedures.postoperative.fit_quality import FitQuality, Usual
from procedures.postoperative.instrument import USUAL_ROD, find_rods
from procedures.postoperative.way import Way

Array = NDArray[np.float64]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class ProvenTrajectory:
    """One trajectory as carried out; points in the planned CT's LPS, mm.

    `entry_error_mm`: distance between the axis and the planned entry, in the plane perpendicular to the
    planned trajectory. `axis_at_target_mm`: the tip, or the point of a hole's axis at the depth of the
    target. `target_error_mm`: from the planned target to the tip; `lateral_mm` is its part across the planned
    trajectory and `depth_error_mm` along it, positive when too deep. A hole has no tip, so these are None,
    except `lateral_mm`, which is then that of its axis. `angle_deg` is between the two axes. `doubts` lists
    what is wrong with the fit.
    """

    identifier: str
    kind: FoundKind
    entry_mm: Point
    axis_at_target_mm: Point
    tip_mm: Point | None
    entry_error_mm: float
    target_error_mm: float | None
    lateral_mm: float
    depth_error_mm: float | None
    angle_deg: float
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Proof:
    """The registration of both scans and every requested trajectory."""

    registration: BoneRegistration
    trajectories: tuple[ProvenTrajectory, ...]


def compare(plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()) -> Proof:
    """Find the object along each trajectory of a plan; `only` names those carried out, by default all.

    Raises PLAN-003, POST-001 to POST-004, POST-006, POST-007, POST-009.
    """
    require_series(plan, pre, post)
    return proof_by(register_on_bone(pre, post), plan, pre, post, only)


def proof_by(
    registration: BoneRegistration, plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()
) -> Proof:
    """The same with a known registration. Raises POST-006, POST-007, POST-009."""
    asked = [one for one in plan.trajectories if not only or one.id in only]
    ways = {one.id: Way(np.array(one.entry_mm), np.array(one.target_mm)) for one in asked}
    candidates = {name: _candidates(way, pre, post, registration) for name, way in ways.items()}
    found, lost_to = assigned(ways, candidates)
    if lost_to:
        pairs = ", ".join(f"{name} and {other}" for name, other in lost_to.items())
        raise InstrumentAmbiguous(f"the same instrument or hole was found along {pairs}")
    if missing := [name for name in ways if name not in found]:
        raise InstrumentMissing(
            f"neither an instrument nor a drilled hole was found along {', '.join(missing)}",
            expected=f"one along each of {len(asked)}",
            got=f"found along {', '.join(found)}" if found else "none",
        )
    if failed := {name: one.failures for name, one in found.items() if one.failures}:
        raise FitFailed(
            "no straight rod or round hole could be fitted to the object along "
            + ", ".join(f"{name} ({found[name].kind}: {'; '.join(why)})" for name, why in failed.items())
        )
    return Proof(registration, tuple(proven(name, way, found[name]) for name, way in ways.items()))


def require_series(plan: Plan, pre: Volume, post: Volume) -> None:
    """Require the plan's series first and a different one second. Raises PLAN-003, POST-003, POST-004."""
    if pre.series_instance_uid == post.series_instance_uid:
        raise OneSeriesTwice("both CTs are the same series", got=pre.series_instance_uid)
    if plan.series_instance_uid == pre.series_instance_uid:
        return
    if plan.series_instance_uid == post.series_instance_uid:
        raise SeriesSwapped("the plan was made on the second CT: the two are swapped")
    raise WrongSeries(
        "the plan belongs to another CT series",
        expected=plan.series_instance_uid,
        got=pre.series_instance_uid,
    )


def _candidates(way: Way, pre: Volume, post: Volume, registration: BoneRegistration) -> tuple[Candidate, ...]:
    """Rods and holes near a planned trajectory, in coordinates of the planned CT."""
    pose = registration.post_from_pre
    back = pose.inv()

    def planned(
        kind: FoundKind, point_mm: Array, outwards: Array, quality: FitQuality, usual: Usual
    ) -> Candidate:
        inwards = -back.rotation.apply(outwards)
        return Candidate(kind, back.apply(point_mm), inwards, usual.failures(quality), usual.doubts(quality))

    return (
        *(
            planned(FoundKind.INSTRUMENT, rod.tip_mm, rod.outwards, rod.quality, USUAL_ROD)
            for rod in find_rods(pre, post, way, pose)
        ),
        *(
            planned(FoundKind.DRILL_HOLE, hole.middle_mm, hole.outwards, hole.quality, USUAL_HOLE)
            for hole in find_holes(pre, post, way, pose)
        ),
    )


def proven(identifier: str, way: Way, found: Candidate) -> ProvenTrajectory:
    """The errors of an instrument or a hole against its planned trajectory."""
    along, point_mm, inwards = way.inwards, found.point_mm, found.inwards
    entry = point_mm + inwards * (float((way.entry_mm - point_mm) @ along) / float(inwards @ along))
    at_target = point_mm
    if found.kind is FoundKind.DRILL_HOLE:
        at_target = point_mm + inwards * (float((way.target_mm - point_mm) @ along) / float(inwards @ along))
    off = at_target - way.target_mm
    depth_mm = float(off @ along)
    angle_rad = np.arctan2(np.linalg.norm(np.cross(inwards, along)), inwards @ along)
    has_tip = found.kind is FoundKind.INSTRUMENT
    return ProvenTrajectory(
        identifier=identifier,
        kind=found.kind,
        entry_mm=_point(entry),
        axis_at_target_mm=_point(at_target),
        tip_mm=_point(point_mm) if has_tip else None,
        entry_error_mm=float(np.linalg.norm(entry - way.entry_mm)),
        target_error_mm=float(np.linalg.norm(off)) if has_tip else None,
        lateral_mm=float(np.linalg.norm(off - depth_mm * along)),
        depth_error_mm=depth_mm if has_tip else None,
        angle_deg=float(np.degrees(angle_rad)),
        doubts=found.doubts,
    )


def _point(values: Array) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
