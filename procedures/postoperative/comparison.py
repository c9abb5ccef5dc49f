"""What was planned against what the CT after the operation shows, trajectory by trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import Volume
from procedures.planning.errors import WrongSeries
from procedures.planning.plan import Plan, PlannedTrajectory
from procedures.postoperative.bone_registration import BoneRegistration, register_on_bone
from procedures.postoperative.drill_hole import find_hole
from procedures.postoperative.errors import (
    InstrumentAmbiguous,
    InstrumentMissing,
    OneSeriesTwice,
    SeriesSwapped,
)
from procedures.postoperative.instrument import find_rod
from procedures.postoperative.way import Way

Array = NDArray[np.float64]
Point = tuple[float, float, float]

ONE_INSTRUMENT_MM = 1.5  # tips nearer than this are one; electrodes are wider


class FoundKind(StrEnum):
    """What was found along a trajectory."""

    INSTRUMENT = "instrument"  # an electrode or a needle: a rod of metal
    DRILL_HOLE = "drill hole"


@dataclass(frozen=True)
class ProvenTrajectory:
    """One trajectory as it was done; points in the planned CT's LPS, mm.

    `entry_error_mm`: how far the axis passes the planned entry, in the plane across the planned way.
    `axis_at_target_mm`: the tip, or where the axis of a hole passes the depth of the target.
    `target_error_mm`: from the planned target to the tip; `lateral_mm` its part across the planned way and
    `depth_error_mm` along it, positive when too deep. A hole has no tip: these are None, but for
    `lateral_mm`, which is then that of its axis. `angle_deg` is between both axes.
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


@dataclass(frozen=True, eq=False)
class Proof:
    """The registration of both scans and every trajectory that was asked for."""

    registration: BoneRegistration
    trajectories: tuple[ProvenTrajectory, ...]


def compare(plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()) -> Proof:
    """Find what lies along the trajectories of a plan; `only` names those that were done, all by default.

    Raises PLAN-003, POST-001 to POST-004, POST-006, POST-007.
    """
    require_series(plan, pre, post)
    return proof_by(register_on_bone(pre, post), plan, pre, post, only)


def proof_by(
    registration: BoneRegistration, plan: Plan, pre: Volume, post: Volume, only: Sequence[str] = ()
) -> Proof:
    """The same by a registration that is known. Raises POST-006, POST-007."""
    asked = [one for one in plan.trajectories if not only or one.id in only]
    found = {one.id: _found(one, pre, post, registration) for one in asked}
    if missing := [name for name, one in found.items() if one is None]:
        there = [name for name, one in found.items() if one is not None]
        raise InstrumentMissing(
            f"neither an instrument nor a drilled hole lies along {', '.join(missing)}",
            expected=f"one along each of {len(asked)}",
            got=f"found along {', '.join(there)}" if there else "none",
        )
    found_all = tuple(one for one in found.values() if one is not None)
    tips = [(one.identifier, np.array(one.tip_mm)) for one in found_all if one.tip_mm is not None]
    for (one, tip), (other, other_tip) in combinations(tips, 2):
        if np.linalg.norm(tip - other_tip) < ONE_INSTRUMENT_MM:
            raise InstrumentAmbiguous(f"the same instrument lies along {one} and {other}")
    return Proof(registration, found_all)


def require_series(plan: Plan, pre: Volume, post: Volume) -> None:
    """The plan is of the first series, and the second is another one. Raises PLAN-003, POST-003, POST-004."""
    if pre.series_instance_uid == post.series_instance_uid:
        raise OneSeriesTwice("both CTs are one series", got=pre.series_instance_uid)
    if plan.series_instance_uid == pre.series_instance_uid:
        return
    if plan.series_instance_uid == post.series_instance_uid:
        raise SeriesSwapped("the plan was made on the second CT: the two are exchanged")
    raise WrongSeries(
        "the plan belongs to another CT series",
        expected=plan.series_instance_uid,
        got=pre.series_instance_uid,
    )


def _found(
    planned: PlannedTrajectory, pre: Volume, post: Volume, registration: BoneRegistration
) -> ProvenTrajectory | None:
    """A rod, else a hole, in the coordinates of the plan."""
    pose = registration.post_from_pre
    way = Way(np.array(planned.entry_mm), np.array(planned.target_mm))
    back = pose.inv()
    rod = find_rod(pre, post, way, pose)
    if rod is not None:
        inwards = -back.rotation.apply(rod.outwards)
        return proven(planned.id, way, back.apply(rod.tip_mm), inwards, FoundKind.INSTRUMENT)
    hole = find_hole(pre, post, way, pose)
    if hole is None:
        return None
    inwards = -back.rotation.apply(hole.outwards)
    return proven(planned.id, way, back.apply(hole.middle_mm), inwards, FoundKind.DRILL_HOLE)


def proven(identifier: str, way: Way, point_mm: Array, inwards: Array, kind: FoundKind) -> ProvenTrajectory:
    """The errors of an axis through a point (3,), the tip of an instrument, against a planned way."""
    along = way.inwards
    entry = point_mm + inwards * (float((way.entry_mm - point_mm) @ along) / float(inwards @ along))
    at_target = point_mm
    if kind is FoundKind.DRILL_HOLE:
        at_target = point_mm + inwards * (float((way.target_mm - point_mm) @ along) / float(inwards @ along))
    off = at_target - way.target_mm
    depth_mm = float(off @ along)
    angle_rad = np.arctan2(np.linalg.norm(np.cross(inwards, along)), inwards @ along)
    has_tip = kind is FoundKind.INSTRUMENT
    return ProvenTrajectory(
        identifier=identifier,
        kind=kind,
        entry_mm=_point(entry),
        axis_at_target_mm=_point(at_target),
        tip_mm=_point(point_mm) if has_tip else None,
        entry_error_mm=float(np.linalg.norm(entry - way.entry_mm)),
        target_error_mm=float(np.linalg.norm(off)) if has_tip else None,
        lateral_mm=float(np.linalg.norm(off - depth_mm * along)),
        depth_error_mm=depth_mm if has_tip else None,
        angle_deg=float(np.degrees(angle_rad)),
    )


def _point(values: Array) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
