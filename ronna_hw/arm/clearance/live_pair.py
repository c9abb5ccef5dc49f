"""Distance between two arms as they are now, for the watch of their motions.

It shares no formula with the planning of paths (`arm_pair`): links come from the closed form of each arm, and
distances are the scalar ones. They are measured again only once the arms may have moved far enough towards
each other to reach the limit, by the levers of their joints as in `live_watch`.
"""

from __future__ import annotations

from math import dist, inf

from ronna_hw.arm.clearance.arm_pair import NO_CLOSENESS, ArmDistance, Closeness, PlacedArm
from ronna_hw.arm.clearance.bodies import segment_distance_mm
from ronna_hw.arm.clearance.live_watch import PlacedBodies
from ronna_hw.arm.kinematics import Segment
from ronna_hw.vectors import JointVector, Vector3


class LivePair:
    """Two placed arms whose bodies are kept apart. What may come closer counts as that much farther apart."""

    def __init__(self, first: PlacedArm, second: PlacedArm, closeness: Closeness = NO_CLOSENESS) -> None:
        self._first, self._second = first, second
        self.closeness = closeness
        self._to_first = first.base.inverse().compose(second.base)
        self._measured: tuple[JointVector, JointVector, float] | None = None  # postures and distance

    def find_near(
        self, first_rad: JointVector, second_rad: JointVector, limit_mm: float
    ) -> ArmDistance | None:
        """Return the distance between the arms in these postures if it is below a limit, else None."""
        if self._measured is not None:
            first_before, second_before, apart_mm = self._measured
            moved_mm = _moved_mm(self._first, first_before, first_rad)
            moved_mm += _moved_mm(self._second, second_before, second_rad)
            if apart_mm - moved_mm >= limit_mm:
                return None
        found = self.distance(first_rad, second_rad)
        self._measured = first_rad, second_rad, found.distance_mm
        return found if found.distance_mm < limit_mm else None

    def distance(self, first_rad: JointVector, second_rad: JointVector) -> ArmDistance:
        """Return the distance between the arms in these postures."""
        found = ArmDistance(inf, "", "")
        others = [
            ((self._to_first.apply(start), self._to_first.apply(end)), radius, name)
            for (start, end), radius, name in _bodies(self._second, second_rad)
        ]
        for (start, end), radius, name in _bodies(self._first, first_rad):
            for (other_start, other_end), other_radius, other_name in others:
                thick = radius + other_radius
                if _far_apart(start, end, other_start, other_end, thick + found.distance_mm):
                    continue
                apart = segment_distance_mm(start, end, other_start, other_end) - thick
                if apart < found.distance_mm:
                    apart += self.closeness.allowance_mm(name, other_name)
                if apart < found.distance_mm:
                    found = ArmDistance(apart, name, other_name)
        return found


def _moved_mm(arm: PlacedArm, before_rad: JointVector, after_rad: JointVector) -> float:
    """Return an upper bound on how far any point of the arm's axes has moved."""
    turns = zip(arm.levers_mm, before_rad, after_rad, strict=True)
    return sum(lever_mm * abs(after - before) for lever_mm, before, after in turns)


def _bodies(arm: PlacedArm, joints_rad: JointVector) -> list[tuple[Segment, float, str]]:
    column = arm.bodies.fixed[0]
    axes = [(column.start_mm, column.end_mm), *PlacedBodies(arm.bodies, joints_rad)]
    return list(zip(axes, arm.radii_mm, arm.names, strict=True))


def _far_apart(a: Vector3, b: Vector3, c: Vector3, d: Vector3, limit_mm: float) -> bool:
    """Return whether two segments are certainly farther apart than a limit, by one end of each."""
    return dist(a, c) - dist(a, b) - dist(c, d) > limit_mm
