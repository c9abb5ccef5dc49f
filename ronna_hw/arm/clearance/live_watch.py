"""Live check of set-points for clearance, body speed, and speed near the head.

Part of the monitor, so it shares no formula with planning: links come from the closed form of the arm,
distances are the scalar ones. A pair is measured again only once its bodies may have moved far enough towards
each other to reach their limit, and the bodies are placed only if bounds from the joint angles alone do not
already clear them.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from heapq import heappop, heappush
from math import degrees, dist, inf
from typing import NamedTuple

from ronna_hw.arm.clearance.bodies import Bodies, segment_distance_mm
from ronna_hw.arm.kinematics import Segment
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import JointVector, joint_vector


class ViolationKind(StrEnum):
    """Kind of limit exceeded: on an axis, by a moving body or, the last two, by a pair of bodies."""

    RANGE = "range"
    TOTAL_CORRECTION = "total correction"
    SPEED = "speed"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    FOLLOWING_ERROR = "following error"  # a stop by the controller causes it too
    BODY_SPEED = "body speed"  # the operating mode's limit, wherever the body is
    CLEARANCE = "clearance"
    ZONE_SPEED = "speed near the head"


_ANGLE_UNITS = {
    ViolationKind.SPEED: "deg/s",
    ViolationKind.ACCELERATION: "deg/s2",
    ViolationKind.JERK: "deg/s3",
}
_BODY_UNITS = {
    ViolationKind.BODY_SPEED: "mm/s",
    ViolationKind.CLEARANCE: "mm",
    ViolationKind.ZONE_SPEED: "mm/s",
}


class Violation(NamedTuple):
    """Limit exceeded by a set-point or a measured pose. Value and limit in rad, mm and seconds.

    `axis` counts from 1. For `BODY_SPEED` it is the index in `Bodies.moving_names`, for `CLEARANCE` and
    `ZONE_SPEED` that in `Bodies.pairs`.
    """

    kind: ViolationKind
    axis: int
    value: float
    limit: float

    @property
    def is_axis_violation(self) -> bool:
        """Whether the violation concerns an axis rather than bodies."""
        return self.kind not in _BODY_UNITS

    def format_value(self, value: float) -> str:
        """Format a value of this kind with its unit."""
        if not self.is_axis_violation:
            return f"{value:.1f} {_BODY_UNITS[self.kind]}"
        unit = _ANGLE_UNITS.get(self.kind)
        return f"{degrees(value):.4f} deg" if unit is None else f"{degrees(value):.1f} {unit}"

    def __str__(self) -> str:
        what = (
            "axis" if self.is_axis_violation else "body" if self.kind is ViolationKind.BODY_SPEED else "pair"
        )
        value, limit = self.format_value(self.value), self.format_value(self.limit)
        return f"{self.kind} of {what} {self.axis}: {value}, limit {limit}"


SPEED_MARGIN = 1.05  # over the cap: planning stays below it, rounding is no violation
SMALLEST_STEP_RAD = 1e-7  # of which the motion is a scale for others; below it rounding counts
LEAVING_MM = 0.5  # a body that starts too close may stay or move away; planning resolves less than this


class PlacedBodies:
    """Axes of all moving bodies in the robot base at given joint angles, ordered as `Bodies.moving_names`.

    Each is computed when it is first asked for.
    """

    def __init__(self, bodies: Bodies, joints_rad: JointVector) -> None:
        self._bodies = bodies
        self._joints = joints_rad
        self._axes: list[Segment | None] = []
        self._flange: Pose | None = None

    def __iter__(self) -> Iterator[Segment]:
        return (self[number] for number in range(len(self._bodies.moving_names)))

    def __getitem__(self, number: int) -> Segment:
        """Return the axis of one body."""
        if self._flange is None:
            links, self._flange = self._bodies.arm.link_segments(self._joints)
            self._axes = [*links, *(None for _ in self._bodies.surroundings.tool)]
        if (axis := self._axes[number]) is None:
            part = self._bodies.surroundings.tool[number - len(self._axes)]
            axis = (self._flange.apply(part.capsule.start_mm), self._flange.apply(part.capsule.end_mm))
            self._axes[number] = axis
        return axis


class _MeasuredStep(NamedTuple):
    """Joint step whose body motion was measured, used to bound the motion of similar steps.

    With a step `e` from `q0` that moves the farthest point by `m`, a step `l e + r` from `q` moves no point
    by more than `l m + l B(e) (|q - q0| + |l - 1| |e|) + B(r)`. `B` is the sum of lever times angle over the
    joints, `| |` the sum of absolute angles: the second derivative of a point's place by two joint angles is
    at most its distance from the outer of the two axes, hence at most that joint's lever.
    """

    from_rad: JointVector
    step_rad: tuple[float, ...]
    square_rad2: float
    size_rad: float
    bound_mm: float
    moved_mm: float

    def bound_of(self, levers_mm: JointVector, from_rad: JointVector, to_rad: JointVector) -> float:
        """Return an upper bound on any point's motion in another step, mm; infinite for a reversed step."""
        along = away = aside = 0.0
        for new, old, step, origin in zip(to_rad, from_rad, self.step_rad, self.from_rad, strict=True):
            along += (new - old) * step
            away += abs(old - origin)
        along /= self.square_rad2
        if along <= 0.0:
            return inf
        for lever, new, old, step in zip(levers_mm, to_rad, from_rad, self.step_rad, strict=True):
            aside += lever * abs(new - old - along * step)
        bent = self.bound_mm * (away + abs(along - 1.0) * self.size_rad)
        return along * (self.moved_mm + bent) + aside


class _Group:
    """Pairs whose distance depends only on joints from `first` outwards, with a motion odometer.

    `first` is 0 for pairs with a body fixed in the room. Otherwise both bodies move: seen from the link that
    turns with joint `first - 1`, the other body moves with the joints beyond.
    """

    def __init__(self, first: int) -> None:
        self.first = first
        self.odometer_mm = 0.0  # bound on the motion of any point, summed over all set-points sent
        self.due_mm = inf  # reading of the odometer before which no pair can have reached its limit
        self._readings: dict[int, float] = {}  # the same, by pair
        self._queue: list[tuple[float, int]] = []  # earliest first, among former ones

    def clear_until(self, reading_mm: float, number: int) -> None:
        """Skip a pair until the odometer reaches this reading, unless a later one is already set."""
        if reading_mm > self._readings.get(number, -inf):
            self._readings[number] = reading_mm
            heappush(self._queue, (reading_mm, number))
            self._find_earliest()

    def take_due(self, moved_mm: float) -> list[int]:
        """Pop the pairs that become due for measurement within this motion.

        Each must be given to `clear_until` again.
        """
        taken = []
        while self.due_mm < self.odometer_mm + moved_mm:
            taken.append(heappop(self._queue)[1])
            del self._readings[taken[-1]]
            self._find_earliest()
        return taken

    def _find_earliest(self) -> None:
        queue = self._queue
        while queue and queue[0][0] != self._readings.get(queue[0][1]):
            heappop(queue)
        self.due_mm = queue[0][0] if queue else inf


class _Trial(NamedTuple):
    """Set-point that was checked but not yet sent."""

    joints_rad: JointVector
    motions: list[float]  # of any point from the last set-point, at most, by first joint of a group
    placed: PlacedBodies
    rooms_mm: dict[int, float]  # motion of its bodies that the gap of a pair allows there


class LiveWatch:
    """Clearance and speed monitor for a stream of set-points.

    `check` does not count a set-point as sent; `sent` does.
    """

    def __init__(
        self, bodies: Bodies, cycle_s: float, joints_rad: JointVector, body_speed_mm_s: float = inf
    ) -> None:
        """Start at rest at `joints_rad`. Bodies that start too close together may only move apart.

        `body_speed_mm_s` is the operating mode's limit for everything that moves.
        """
        self._bodies = bodies
        self._surroundings = surroundings = bodies.surroundings
        self._cycle_s = cycle_s
        self._body_speed_mm_s = body_speed_mm_s
        self._pairs = bodies.pairs
        self._fixed = tuple((item.start_mm, item.end_mm) for item in bodies.fixed)
        fixed_radii = tuple(item.radius_mm for item in bodies.fixed)
        radii = bodies.moving_radii_mm
        self._radius_sums_mm = tuple(
            radii[pair.moving] + (radii[-1 - pair.other] if pair.other < 0 else fixed_radii[pair.other])
            for pair in self._pairs
        )
        tool = [end for part in surroundings.tool for end in part.capsule[:2]]
        self._levers = _outwards(bodies.arm.levers_mm(tool))
        placed = self._placed = PlacedBodies(bodies, joints_rad)
        self._joints = joints_rad
        self._measured: _MeasuredStep | None = None
        self._trials: list[_Trial] = []  # since the last set-point that was sent
        gaps = [self._gap(number, placed) for number in range(len(self._pairs))]
        self._floors = [min(surroundings.live_margin_mm, gap - LEAVING_MM) for gap in gaps]
        self._share: list[float] = []
        self._group_of: list[_Group] = []
        groups = {first: _Group(first) for first in range(len(joints_rad) + 1)}
        for number, (pair, gap) in enumerate(zip(self._pairs, gaps, strict=True)):
            first = bodies.arm.links[-1 - pair.other].joint + 1 if pair.other < 0 else 0
            self._share.append(self._lever_share(pair.moving, first))
            self._group_of.append(groups[first])
            groups[first].clear_until(self._room_mm(number, gap), number)
        self._room = groups[0]
        self._groups = tuple(group for group in groups.values() if group.due_mm < inf or group is self._room)
        # Slower than any cap, wherever the head is.
        self._slowest_mm = self._allowed_mm(0.0)
        self._head = [number for number, pair in enumerate(self._pairs) if pair.is_head]
        # Distance to the head plus the room's odometer at that time: minus its reading now, a lower bound.
        self._bounds = [self._distance(number, placed) for number in self._head]
        self._least_bound = min(self._bounds, default=inf)

    def check(self, joints_rad: JointVector) -> Violation | None:
        """Return the first violation that sending this set-point next would cause, or None."""
        motions = self._bound_motions_mm(self._joints, joints_rad)
        placed = PlacedBodies(self._bodies, joints_rad)
        slow = self._is_slow(motions[0])
        if not slow and self._measured is not None:
            motions[0] = min(motions[0], self._measured.bound_of(self._levers, self._joints, joints_rad))
            slow = self._is_slow(motions[0])
        if not slow:
            motions[0] = max(self._motions_mm(placed))
            self._measure(joints_rad, motions[0])
        trial = _Trial(joints_rad, motions, placed, {})
        found = self._find_clearance_violation(trial)
        self._trials.append(trial)
        return found if slow or found else self._find_speed_violation(placed, motions[0])

    def sent(self, joints_rad: JointVector) -> None:
        """Record a set-point as sent, or as the arm's current position."""
        if joints_rad is self._joints:
            self._trials.clear()
            return
        trial = next((item for item in self._trials if item.joints_rad is joints_rad), None)
        if trial is None:
            motions = self._bound_motions_mm(self._joints, joints_rad)
            trial = _Trial(joints_rad, motions, PlacedBodies(self._bodies, joints_rad), {})
        for group in self._groups:
            group.odometer_mm += trial.motions[group.first]
        for number, room_mm in trial.rooms_mm.items():
            group = self._group_of[number]
            group.clear_until(group.odometer_mm + room_mm, number)
        self._joints, self._placed = joints_rad, trial.placed
        self._trials.clear()

    def _bound_motions_mm(self, from_rad: JointVector, to_rad: JointVector) -> list[float]:
        """Return upper bounds on any point's motion between two joint vectors, mm.

        Item i counts joints from i outwards.
        """
        motion_mm, motions = 0.0, [0.0] * (len(self._levers) + 1)
        for number in reversed(range(len(self._levers))):
            motion_mm += self._levers[number] * abs(to_rad[number] - from_rad[number])
            motions[number] = motion_mm
        return motions

    def _is_slow(self, most: float) -> bool:
        """Return whether a motion of at most `most` mm stays below every speed cap."""
        if most <= self._slowest_mm:
            return True
        return most <= self._allowed_mm(self._least_bound - self._room.odometer_mm - most)

    def _allowed_mm(self, distance_mm: float) -> float:
        """Return the longest motion allowed per cycle at a distance from the head, mm."""
        cap_mm_s = min(self._surroundings.cap_mm_s(distance_mm), self._body_speed_mm_s)
        return cap_mm_s * SPEED_MARGIN * self._cycle_s

    def _measure(self, joints_rad: JointVector, moved_mm: float) -> None:
        """Keep this step and its exact motion as the reference for bounding later steps."""
        step = tuple(new - old for new, old in zip(joints_rad, self._joints, strict=True))
        if (square := sum(angle * angle for angle in step)) > SMALLEST_STEP_RAD**2:
            size = sum(abs(angle) for angle in step)
            bound = sum(lever * abs(angle) for lever, angle in zip(self._levers, step, strict=True))
            self._measured = _MeasuredStep(self._joints, step, square, size, bound, moved_mm)

    def _find_clearance_violation(self, trial: _Trial) -> Violation | None:
        found: Violation | None = None
        for group in self._groups:
            moved = trial.motions[group.first]
            if group.odometer_mm + moved <= group.due_mm:
                continue
            for number in group.take_due(moved):
                if (room_mm := self._room_left_mm(number, group, trial)) <= 0.0:
                    gap, floor = self._gap(number, trial.placed), self._floors[number]
                    if gap < floor and found is None:
                        found = Violation(ViolationKind.CLEARANCE, number, gap, floor)
                    room_mm = self._room_mm(number, gap)
                # Should another set-point be sent, the gap may be smaller by this one's motion.
                group.clear_until(group.odometer_mm - moved + room_mm, number)
                trial.rooms_mm[number] = room_mm
        return found

    def _room_left_mm(self, number: int, group: _Group, trial: _Trial) -> float:
        """Return a pair's guaranteed remaining room, mm; 0 if the previous check did not measure it."""
        if not self._trials or number not in self._trials[-1].rooms_mm:
            return 0.0
        before = self._trials[-1]
        between = self._bound_motions_mm(before.joints_rad, trial.joints_rad)
        return before.rooms_mm[number] - between[group.first]

    def _find_speed_violation(self, placed: PlacedBodies, moved: float) -> Violation | None:
        if (speed := moved / self._cycle_s) > self._body_speed_mm_s * SPEED_MARGIN:
            motions = self._motions_mm(placed)
            fastest = motions.index(max(motions))
            return Violation(ViolationKind.BODY_SPEED, fastest, speed, self._body_speed_mm_s)
        cap = self._surroundings.cap_mm_s
        bounds, odometer = self._bounds, self._room.odometer_mm
        travel = odometer + moved
        if speed <= cap(self._least_bound - travel):
            return None
        nearest, nearest_pair = inf, 0
        for place in sorted(range(len(bounds)), key=bounds.__getitem__):
            if bounds[place] - travel >= nearest:
                break
            distance = self._distance(self._head[place], placed)
            bounds[place] = distance - moved + odometer
            if distance < nearest:
                nearest, nearest_pair = distance, self._head[place]
        self._least_bound = min(bounds, default=inf)
        limit = cap(nearest)
        if speed <= limit * SPEED_MARGIN:
            return None
        return Violation(ViolationKind.ZONE_SPEED, nearest_pair, speed, limit)

    def _motions_mm(self, placed: PlacedBodies) -> list[float]:
        """Return each body's motion since the last set-point, mm, at its faster end."""
        return [
            max(dist(now[0], before[0]), dist(now[1], before[1]))
            for now, before in zip(placed, self._placed, strict=True)
        ]

    def _gap(self, number: int, placed: PlacedBodies) -> float:
        """Return the surface distance of a pair, mm; infinite where a corridor allows contact."""
        pair = self._pairs[number]
        corridor = self._surroundings.corridor
        if (
            corridor is not None
            and pair.enters_head
            and pair.is_head
            and corridor.holds(*placed[pair.moving])
        ):
            return inf
        return self._distance(number, placed)

    def _room_mm(self, number: int, gap: float) -> float:
        """Return the odometer travel, mm, after which a pair must be measured again."""
        if gap == inf:  # in its corridor, which it may leave sideways at any time
            return 0.0
        return (gap - self._floors[number]) / self._share[number]

    def _lever_share(self, moving: int, first: int) -> float:
        """Return the largest ratio of a body's levers to those of any body, for joints from `first` on."""
        part = moving - len(self._bodies.arm.links)
        if not first or part < 0:  # the motion in the room may have been measured: it is of any body
            return 1.0
        levers = self._bodies.arm.levers_mm(self._surroundings.tool[part].capsule[:2])
        shares = [own / most for own, most in zip(levers[first:], self._levers[first:], strict=True) if most]
        return max(shares, default=1.0) or 1.0

    def _distance(self, number: int, placed: PlacedBodies) -> float:
        pair = self._pairs[number]
        other = placed[-1 - pair.other] if pair.other < 0 else self._fixed[pair.other]
        return segment_distance_mm(*placed[pair.moving], *other) - self._radius_sums_mm[number]


def _outwards(levers_mm: JointVector) -> JointVector:
    """Raise each lever to at least that of every joint farther out, as `_MeasuredStep` requires."""
    return joint_vector(max(levers_mm[number:]) for number in range(len(levers_mm)))
