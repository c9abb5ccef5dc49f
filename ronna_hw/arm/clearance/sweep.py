"""Clearance check along an entire planned path: distances between all pairs of bodies, with NumPy.

The path is sampled. Between two samples a pair cannot come closer than half of the sum of both distances
minus the motion in between. Where that bound is not enough, the interval is halved, down to `FINEST_MM` of
motion.

The live monitoring of the real-time process has formulas of its own, so that one mistake cannot hide in both:
here the chain is multiplied out joint by joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from math import ceil

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.arm.clearance.bodies import Bodies, Surroundings
from ronna_hw.arm.clearance.pair_distances import KEPT_BODIES, list_columns, segment_distances
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.planning import JointPath, LinePath, MotionPlan
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, Vector3, joint_vector

FIRST_SAMPLES = 9
STEP_MM = 12.0  # initial motion between two samples
STEP_RAD = 0.1  # of any joint: within this, a path between two samples is straight to 0.05 %
FINEST_MM = 0.5
ARC_FACTOR = 1.01  # between two samples a body moves along an arc, not its chord
LEAVING_MM = 0.05  # a body that starts too close may stay or move away; this much does not count as approach
UNCHANGED_MM = 1.0  # bodies of an arm whose distance varies by less on a path turn together on it
ALIKE_MM = 1e-6  # two distances closer than this are equal up to rounding
KEPT_PATHS = 64  # a path is swept when planned, when previewed and when driven: about 10 MB


@dataclass(frozen=True)
class ClosestPair:
    """Closest approach on a path: the two bodies, their distance, and the path position (0..1)."""

    first: str
    second: str
    distance_mm: float
    fraction: float


@dataclass(frozen=True)
class SweepSamples:
    """Body positions and distances at n samples of a path.

    `gaps_mm` (n, pairs) are surface distances, infinite where a corridor allows contact; `to_head_mm` is (n).

    `ends_mm` (n, bodies, 2, 3): both ends of every moving body's axis in $ROBROOT. `to_head_mm` is the
    smallest distance between the head and anything that moves, not negative, and infinite without a head.
    """

    ends_mm: Array
    gaps_mm: Array
    to_head_mm: Array


@dataclass(frozen=True)
class SweptPath:
    """Sampled path with its distances; fractions (n) from 0 to 1, joints (n, axes)."""

    bodies: Bodies
    fractions: Array
    joints_rad: Array
    swept: SweepSamples

    @property
    def closest(self) -> ClosestPair | None:
        """Closest pair on the path, or None if there is nothing to collide with.

        Pairs of the arm's own bodies that this path leaves as they are, at more than the planned clearance,
        count only if there are no others: nothing about them changes.
        """
        gaps = self.swept.gaps_mm
        if not gaps.size or not np.isfinite(gaps).any():
            return None
        largest_mm = np.where(np.isfinite(gaps), gaps, -np.inf).max(axis=0)
        own = np.array([pair.other < 0 for pair in self.bodies.pairs])
        least_mm = gaps.min(axis=0)
        near = least_mm <= self.bodies.surroundings.margin_mm
        counts = ~own | near | (largest_mm - least_mm > UNCHANGED_MM)
        counted = np.where(counts, gaps, np.inf)
        return self._pair_at(_first_smallest(counted if np.isfinite(counted).any() else gaps))

    @property
    def refused(self) -> ClosestPair | None:
        """Pair with the worst clearance violation, or None if the path is clear.

        A pair that is too close at the start must not come any closer.
        """
        deficit_mm = self.swept.gaps_mm - floors_mm(self.bodies.surroundings, self.swept.gaps_mm[0])
        if not deficit_mm.size or deficit_mm.min() >= 0.0:
            return None
        return self._pair_at(_first_smallest(deficit_mm))

    def require(self, what: str = "the path") -> None:
        """Raise ARM-007 with the pair, the distance and the position if the path is not clear."""
        if (offender := self.refused) is None:
            return
        raise NotClear(
            f"on {what} the {offender.first} would come too close to the {offender.second}, "
            f"{offender.fraction:.0%} of the path",
            limit=f"{self.bodies.surroundings.margin_mm:g} mm",
            got=f"{offender.distance_mm:.1f} mm",
        )

    def _pair_at(self, place: int) -> ClosestPair:
        row, column = np.unravel_index(place, self.swept.gaps_mm.shape)
        first, second = self.bodies.names(self.bodies.pairs[column])
        gap = float(self.swept.gaps_mm[row, column])
        return ClosestPair(first, second, gap, float(self.fractions[row]))


def sweep_path(
    kinematics: Kinematics, plan: MotionPlan, surroundings: Surroundings, *, search_closest: bool = True
) -> SweptPath:
    """Sweep all bodies along a planned path. Raises ARM-001 to ARM-003 for an unreachable path.

    A path that is not clear is searched for its closest point, for the message; without `search_closest` only
    until the result is certain.
    """
    swept = _sweep_path(kinematics, plan, surroundings, search_closest=False)
    if not search_closest or swept.refused is None:  # a clear path is the same either way
        return swept
    return _sweep_path(kinematics, plan, surroundings, search_closest=True)


@lru_cache(KEPT_PATHS)
def _sweep_path(
    kinematics: Kinematics, plan: MotionPlan, surroundings: Surroundings, *, search_closest: bool
) -> SweptPath:
    path = plan.path(kinematics)
    bodies = _collect_bodies(kinematics, surroundings)
    fractions = np.linspace(0.0, 1.0, FIRST_SAMPLES)
    joints = _sample_joints(path, plan.start_rad, fractions)
    ends = moving_ends(bodies, joints)
    count = max(
        FIRST_SAMPLES,
        ceil(float(_end_motions_mm(ends).max(axis=1).sum()) / STEP_MM) + 1,
        ceil(float(np.abs(np.diff(joints, axis=0)).max(axis=1).sum()) / STEP_RAD) + 1,
    )
    if count > FIRST_SAMPLES:
        fractions = np.linspace(0.0, 1.0, count)
        joints = _sample_joints(path, plan.start_rad, fractions)
        ends = moving_ends(bodies, joints)
    found = _measure_gaps(bodies, ends)
    floors = floors_mm(surroundings, found.gaps_mm[0])
    while True:
        if not search_closest and (found.gaps_mm < floors).any():
            break
        wanted = np.minimum(floors, found.gaps_mm.min(axis=0))
        open_rows = np.flatnonzero(_find_open_intervals(bodies, found, wanted))
        if not len(open_rows):
            break
        middles = (fractions[open_rows] + fractions[open_rows + 1]) / 2.0
        starts = joints[open_rows].tolist()
        between = np.array(
            [path.joints(s, joint_vector(at)) for s, at in zip(middles.tolist(), starts, strict=True)]
        )
        more = sweep(bodies, between)
        fractions = np.insert(fractions, open_rows + 1, middles)
        joints = np.insert(joints, open_rows + 1, between, axis=0)
        found = SweepSamples(
            np.insert(found.ends_mm, open_rows + 1, more.ends_mm, axis=0),
            np.insert(found.gaps_mm, open_rows + 1, more.gaps_mm, axis=0),
            np.insert(found.to_head_mm, open_rows + 1, more.to_head_mm),
        )
    for values in (fractions, joints, found.ends_mm, found.gaps_mm, found.to_head_mm):  # callers share them
        values.setflags(write=False)
    return SweptPath(bodies, fractions, joints, found)


@lru_cache(KEPT_BODIES)
def _collect_bodies(kinematics: Kinematics, surroundings: Surroundings) -> Bodies:
    return Bodies(kinematics, surroundings)


def floors_mm(surroundings: Surroundings, at_start_mm: Array) -> Array:
    """Return each pair's minimum distance (pairs,), relaxed for pairs too close together at the start."""
    return np.asarray(np.minimum(surroundings.margin_mm, at_start_mm - LEAVING_MM))


def motion_mm(swept: SweepSamples) -> Array:
    """Return upper bounds on each body's motion between consecutive samples, (n - 1, bodies)."""
    return _end_motions_mm(swept.ends_mm) * ARC_FACTOR


def _first_smallest(distances_mm: Array) -> int:
    """Return the flat index of the smallest distance, or of the first one equal to it up to rounding.

    Bodies that rotate together keep their distance: the last digits must not decide the position on the path.
    """
    return int(np.argmax(distances_mm <= distances_mm.min() + ALIKE_MM))


def _find_open_intervals(bodies: Bodies, found: SweepSamples, floors: Array) -> NDArray[np.bool_]:
    """Return a mask of the intervals (n - 1) that may hide a distance below its minimum."""
    moved = motion_mm(found)
    columns = list_columns(bodies)
    relative = moved[:, columns.moving]
    relative[:, columns.own] += moved[:, columns.partners]
    before, after = found.gaps_mm[:-1], found.gaps_mm[1:]
    with np.errstate(invalid="ignore"):
        bound = (before + after - relative) / 2.0
    # If a corridor allows contact at one end of the interval, only the distance at the other end is known.
    half = np.isinf(before) ^ np.isinf(after)
    bound = np.where(half, np.minimum(before, after) - relative, bound)
    bound = np.where(np.isinf(before) & np.isinf(after), np.inf, bound)
    return np.asarray(((bound < floors) & (relative > FINEST_MM)).any(axis=1))


def _end_motions_mm(ends_mm: Array) -> Array:
    return np.asarray(np.linalg.norm(np.diff(ends_mm, axis=0), axis=3).max(axis=2))


def _sample_joints(path: JointPath | LinePath, start_rad: JointVector, fractions: Array) -> Array:
    found = [start_rad]
    for s in fractions[1:].tolist():
        found.append(path.joints(s, found[-1]))
    return np.array(found)


def sweep(bodies: Bodies, joints_rad: ArrayLike) -> SweepSamples:
    """Compute body positions and distances at joint vectors (n, axes)."""
    return _measure_gaps(bodies, moving_ends(bodies, np.atleast_2d(np.asarray(joints_rad, dtype=float))))


def _measure_gaps(bodies: Bodies, ends: Array) -> SweepSamples:
    columns = list_columns(bodies)
    axes = np.ascontiguousarray(np.transpose(ends, (2, 3, 0, 1)))  # component by component: much faster
    partner = np.empty((2, 3, len(ends), len(bodies.pairs)))
    partner[..., columns.own] = axes[..., columns.partners]
    partner[..., ~columns.own] = columns.fixed_mm[:, :, None, :]
    first = axes[..., columns.moving]
    gaps = segment_distances(first[0], first[1], partner[0], partner[1]) - columns.thick_mm
    to_head = np.full(len(ends), np.inf)
    if columns.head.any():
        to_head = np.maximum(gaps[:, columns.head].min(axis=1), 0.0)
    if (corridor := bodies.surroundings.corridor) is not None:
        for column, pair in enumerate(bodies.pairs):
            if pair.enters_head and pair.is_head:
                inside = [corridor.holds(tuple(start), tuple(end)) for start, end in ends[:, pair.moving]]
                gaps[inside, column] = np.inf
    return SweepSamples(ends, gaps, to_head)


def moving_ends(bodies: Bodies, joints: Array) -> Array:
    """Return the axis ends of all moving bodies, arm and tool, (n, bodies, 2, 3) mm."""
    chain = bodies.arm.chain
    origin = np.tile(np.array(chain.base_mm), (len(joints), 1))
    turn: Array | None = None
    frames = []
    for number, joint in enumerate(chain.joints):
        own = _rotation(joint.axis, joints[:, number])
        turn = own if turn is None else turn @ own
        frames.append((origin, turn))
        origin = _place_point(origin, turn, joint.to_next_mm)
    assert turn is not None
    flange = origin, turn @ np.reshape(chain.flange_rotation, (3, 3))
    links, tool = bodies.arm.links, bodies.surroundings.tool
    ends = np.empty((len(joints), len(links) + len(tool), 2, 3))
    for body, link in enumerate(links):
        ends[:, body, 0] = _place_point(*frames[link.joint], link.start_mm)
        ends[:, body, 1] = _place_point(*frames[link.joint], link.end_mm)
    for body, part in enumerate(tool, start=len(links)):
        ends[:, body, 0] = _place_point(*flange, part.capsule.start_mm)
        ends[:, body, 1] = _place_point(*flange, part.capsule.end_mm)
    return ends


@cache
def _rotation_parts(axis: Vector3) -> tuple[Array, Array, Array]:
    """Split a rotation about a unit vector into constant, cosine and sine parts, (3, 3, 1) each."""
    x, y, z = axis
    along = np.outer(axis, axis)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return along[:, :, None], (np.eye(3) - along)[:, :, None], across[:, :, None]


def _rotation(axis: Vector3, angles: Array) -> Array:
    """Return the rotation matrices (n, 3, 3) about one axis."""
    along, plane, across = _rotation_parts(axis)
    return (along + np.cos(angles) * plane + np.sin(angles) * across).transpose(2, 0, 1)


def _place_point(origin: Array, turn: Array, point_mm: Vector3) -> Array:
    """Transform a point of a moving frame to the robot base, (n, 3)."""
    return origin + turn @ np.array(point_mm) if any(point_mm) else origin
