"""Live check of set-points: the distances of all bodies, their speed, and their speed near the head.

Part of the monitor, so it shares no formula with planning: links come from the closed form of the arm,
distances are the scalar ones. A pair is measured again only once the arm may have moved enough to bring it to
its limit. Bodies are placed only if a bound from the joint angles does not already clear them.
"""

from __future__ import annotations

from enum import StrEnum
from heapq import heapify, heappop, heappush
from math import degrees, dist, inf
from typing import NamedTuple

from ronna_hw.arm.clearance.bodies import Bodies, segment_distance_mm
from ronna_hw.arm.kinematics import Segment
from ronna_hw.vectors import JointVector


class ViolationKind(StrEnum):
    """Limit that was exceeded: of an axis, of a moving body, or, the last two, of a pair of bodies."""

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
    """A limit that a set-point or a measured pose exceeds, with value and limit in rad, mm and seconds.

    `axis` counts from 1. For `BODY_SPEED` it is the index in `Bodies.moving_names`, for `CLEARANCE` and
    `ZONE_SPEED` that in `Bodies.pairs`.
    """

    kind: ViolationKind
    axis: int
    value: float
    limit: float

    @property
    def of_axis(self) -> bool:
        """True if an axis is at fault rather than two bodies."""
        return self.kind not in _BODY_UNITS

    def in_units(self, value: float) -> str:
        """Format a value of this kind for people."""
        if not self.of_axis:
            return f"{value:.1f} {_BODY_UNITS[self.kind]}"
        unit = _ANGLE_UNITS.get(self.kind)
        return f"{degrees(value):.4f} deg" if unit is None else f"{degrees(value):.1f} {unit}"

    def __str__(self) -> str:
        what = "axis" if self.of_axis else "body" if self.kind is ViolationKind.BODY_SPEED else "pair"
        value, limit = self.in_units(self.value), self.in_units(self.limit)
        return f"{self.kind} of {what} {self.axis}: {value}, limit {limit}"


SPEED_MARGIN = 1.05  # over the cap: planning stays below it, rounding is no violation
LEAVING_MM = 0.5  # a body that starts too close may stay or move away; planning resolves less than this


def body_segments(bodies: Bodies, joints_rad: JointVector) -> list[Segment]:
    """Axes of all moving bodies in the robot base, in the order of `Bodies.moving_names`."""
    found, flange = bodies.arm.link_segments(joints_rad)
    for part in bodies.surroundings.tool:
        start, end, _ = part.capsule
        found.append((flange.apply(start), flange.apply(end)))
    return found


class LiveWatch:
    """Clearance monitor of one stream in its surroundings.

    `check` does not count a set-point as sent; `sent` does.
    """

    def __init__(
        self,
        bodies: Bodies,
        cycle_s: float,
        joints_rad: JointVector,
        body_speed_mm_s: float = inf,
    ) -> None:
        """`joints_rad` is the arm's position at rest; whatever starts too close may only move away.

        `body_speed_mm_s` is the operating mode's limit for everything that moves.
        """
        self._bodies = bodies
        self._surroundings = surroundings = bodies.surroundings
        self._cycle_s = cycle_s
        self._body_speed_mm_s = body_speed_mm_s
        self._pairs = bodies.pairs
        self._fixed = tuple((one.start_mm, one.end_mm) for one in bodies.fixed)
        fixed_radii = tuple(one.radius_mm for one in bodies.fixed)
        radii = bodies.moving_radii_mm
        self._thick = tuple(
            radii[pair.moving] + (radii[-1 - pair.other] if pair.other < 0 else fixed_radii[pair.other])
            for pair in self._pairs
        )
        tool = [end for part in surroundings.tool for end in part.capsule[:2]]
        self._levers = bodies.arm.levers_mm(tool)
        segments = body_segments(bodies, joints_rad)
        self._segments: list[Segment] | None = segments  # position of the bodies at `_joints`, once computed
        self._joints = joints_rad
        self._tried: tuple[JointVector, list[Segment] | None, float] | None = None
        self._odometer_mm = 0.0  # bound on the largest motion of any body, summed over all set-points sent
        gaps = [self._gap(number, segments) for number in range(len(self._pairs))]
        self._floors = [min(surroundings.live_margin_mm, gap - LEAVING_MM) for gap in gaps]
        # Odometer reading before which a pair cannot have reached its limit.
        self._due = [
            ((gap - floor) * self._share(number) if gap < inf else 0.0, number)
            for number, (gap, floor) in enumerate(zip(gaps, self._floors, strict=True))
        ]
        heapify(self._due)
        self._head = [number for number, pair in enumerate(self._pairs) if pair.is_head]
        # Distance to the head plus the odometer at that time: minus the current odometer, a lower bound.
        self._bounds = [self._distance(number, segments) for number in self._head]

    def check(self, joints_rad: JointVector) -> Violation | None:
        """Return the first violation if this set-point were sent next, or None."""
        most = self._motion_bound_mm(joints_rad)
        if self._is_clearly_safe(most):
            self._tried = (joints_rad, None, most)
            return None
        segments = body_segments(self._bodies, joints_rad)
        moved = max(self._motions_mm(segments))
        self._tried = (joints_rad, segments, moved)
        return self._too_near(segments, moved) or self._too_fast(segments, moved)

    def sent(self, joints_rad: JointVector) -> None:
        """Record a set-point that was sent, or is the current position of the arm."""
        if joints_rad is self._joints:
            return
        segments, moved = None, 0.0
        if self._tried is not None and self._tried[0] is joints_rad:
            _, segments, moved = self._tried
        else:
            moved = self._motion_bound_mm(joints_rad)
        self._odometer_mm += moved
        self._joints, self._segments = joints_rad, segments

    def _motion_bound_mm(self, joints_rad: JointVector) -> float:
        """Upper bound of the largest motion of any body since the last set-point, mm."""
        a, b, c, d, e, f = self._levers
        p1, p2, p3, p4, p5, p6 = joints_rad
        q1, q2, q3, q4, q5, q6 = self._joints
        return (
            a * abs(p1 - q1)
            + b * abs(p2 - q2)
            + c * abs(p3 - q3)
            + d * abs(p4 - q4)
            + e * abs(p5 - q5)
            + f * abs(p6 - q6)
        )

    def _is_clearly_safe(self, most: float) -> bool:
        """Whether a motion of at most `most` mm neither makes a pair due nor reaches a speed cap."""
        travel = self._odometer_mm + most
        if self._due and self._due[0][0] < travel:
            return False
        if most == 0.0:
            return True
        nearest = min(self._bounds) - travel if self._bounds else inf
        cap_mm_s = min(self._surroundings.cap_mm_s(nearest), self._body_speed_mm_s)
        return most <= cap_mm_s * self._cycle_s

    def _too_near(self, segments: list[Segment], moved: float) -> Violation | None:
        travel = self._odometer_mm + moved
        again: list[tuple[float, int]] = []
        found: Violation | None = None
        while self._due and self._due[0][0] < travel:
            _, number = heappop(self._due)
            gap, floor = self._gap(number, segments), self._floors[number]
            if gap < floor and found is None:
                found = Violation(ViolationKind.CLEARANCE, number, gap, floor)
            # A body in its corridor is checked every cycle: it may leave it sideways.
            room = (gap - floor) * self._share(number) if gap < inf else 0.0
            again.append((self._odometer_mm - moved + room, number))
        for one in again:
            heappush(self._due, one)
        return found

    def _too_fast(self, segments: list[Segment], moved: float) -> Violation | None:
        speed = moved / self._cycle_s
        if speed > self._body_speed_mm_s * SPEED_MARGIN:
            motions = self._motions_mm(segments)
            fastest = motions.index(max(motions))
            return Violation(ViolationKind.BODY_SPEED, fastest, speed, self._body_speed_mm_s)
        cap = self._surroundings.cap_mm_s
        bounds, travel = self._bounds, self._odometer_mm + moved
        if not bounds or speed <= cap(min(bounds) - travel):
            return None
        nearest, which = inf, 0
        for place in sorted(range(len(bounds)), key=bounds.__getitem__):
            if bounds[place] - travel >= nearest:
                break
            distance = self._distance(self._head[place], segments)
            bounds[place] = distance - moved + self._odometer_mm
            if distance < nearest:
                nearest, which = distance, self._head[place]
        limit = cap(nearest)
        if speed <= limit * SPEED_MARGIN:
            return None
        return Violation(ViolationKind.ZONE_SPEED, which, speed, limit)

    def _motions_mm(self, segments: list[Segment]) -> list[float]:
        """Largest motion of an end of each body since the last set-point."""
        if self._segments is None:
            self._segments = body_segments(self._bodies, self._joints)
        return [
            max(dist(now[0], before[0]), dist(now[1], before[1]))
            for now, before in zip(segments, self._segments, strict=True)
        ]

    def _gap(self, number: int, segments: list[Segment]) -> float:
        """Distance between the surfaces of a pair; infinite where a corridor allows contact."""
        pair = self._pairs[number]
        corridor = self._surroundings.corridor
        if (
            corridor is not None
            and pair.enters_head
            and pair.is_head
            and corridor.holds(*segments[pair.moving])
        ):
            return inf
        return self._distance(number, segments)

    def _distance(self, number: int, segments: list[Segment]) -> float:
        pair = self._pairs[number]
        other = segments[-1 - pair.other] if pair.other < 0 else self._fixed[pair.other]
        return segment_distance_mm(*segments[pair.moving], *other) - self._thick[number]

    def _share(self, number: int) -> float:
        """Share of a pair's gap that one body may use up: both may move towards each other."""
        return 0.5 if self._pairs[number].other < 0 else 1.0
