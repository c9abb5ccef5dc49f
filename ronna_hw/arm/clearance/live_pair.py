"""Distance between two arms as they are now, for the watch of their motions.

It shares no formula with the planning of paths (`arm_pair`): links come from the closed form of each arm, and
distances are the scalar ones.
"""

from __future__ import annotations

from math import dist, inf

from ronna_hw.arm.clearance.arm_pair import ArmDistance, PlacedArm
from ronna_hw.arm.clearance.bodies import segment_distance_mm
from ronna_hw.arm.clearance.live_watch import PlacedBodies
from ronna_hw.arm.kinematics import Segment
from ronna_hw.vectors import JointVector, Vector3


class LivePair:
    """Two placed arms whose bodies are kept apart."""

    def __init__(self, first: PlacedArm, second: PlacedArm) -> None:
        self._first, self._second = first, second
        to_first = first.base.inverse()
        self._to_first = to_first.compose(second.base)

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
                    found = ArmDistance(apart, name, other_name)
        return found


def _bodies(arm: PlacedArm, joints_rad: JointVector) -> list[tuple[Segment, float, str]]:
    column = arm.bodies.fixed[0]
    axes = [(column.start_mm, column.end_mm), *PlacedBodies(arm.bodies, joints_rad)]
    return list(zip(axes, arm.radii_mm, arm.names, strict=True))


def _far_apart(a: Vector3, b: Vector3, c: Vector3, d: Vector3, limit_mm: float) -> bool:
    """Return whether two segments are certainly farther apart than a limit, by one end of each."""
    return dist(a, c) - dist(a, b) - dist(c, d) > limit_mm
