"""Two placed arms in one collision world: the distance between them, which is coal's.

Import it when two arms are planned: loading coal takes 35 ms, which a single arm need not spend.
"""

from __future__ import annotations

import coal
import numpy as np

from ronna_hw.arm.clearance.arm_pair import NO_CLOSENESS, ArmDistance, Closeness, PlacedArm
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector

POINT_MM = 1e-6  # a shorter axis has no direction
NO_TURN = np.eye(3)


class ArmPairWorld:
    """Collision world of two placed arms. What may come closer counts as that much farther apart."""

    def __init__(self, first: PlacedArm, second: PlacedArm, closeness: Closeness = NO_CLOSENESS) -> None:
        self.first, self.second = first, second
        self._closeness = closeness
        self._shapes: dict[tuple[int, int], coal.CollisionObject] = {}
        self._request = coal.DistanceRequest()
        self._result = coal.DistanceResult()

    def distance(self, first_rad: JointVector | Array, second_rad: JointVector | Array) -> ArmDistance:
        """Return the distance between the arms in a pair of postures."""
        first, second = self.first.axes(np.asarray(first_rad)), self.second.axes(np.asarray(second_rad))
        return self.distance_of(first[0], second[0])

    def distance_of(self, first_axes_mm: Array, second_axes_mm: Array) -> ArmDistance:
        """Return the distance between arms whose bodies have these axes (bodies, 2, 3)."""
        ones = self._place(0, self.first, first_axes_mm)
        others = self._place(1, self.second, second_axes_mm)
        found = ArmDistance(np.inf, "", "")
        for one, first in zip(ones, self.first.names, strict=True):
            for other, second in zip(others, self.second.names, strict=True):
                if (allowance_mm := self._closeness.allowance_mm(first, second)) == np.inf:
                    continue
                self._result.clear()
                apart = coal.distance(one, other, self._request, self._result) + allowance_mm
                if apart < found.distance_mm:
                    found = ArmDistance(float(apart), first, second)
        return found

    def _place(self, number: int, arm: PlacedArm, axes_mm: Array) -> list[coal.CollisionObject]:
        placed = []
        for body, ((start, end), radius) in enumerate(zip(axes_mm, arm.radii_mm, strict=True)):
            along = end - start
            length = float(np.linalg.norm(along))
            if (shape := self._shapes.get((number, body))) is None:
                solid = coal.Capsule(radius, length) if length > POINT_MM else coal.Sphere(radius)
                shape = self._shapes[number, body] = coal.CollisionObject(solid)
            shape.setTransform(coal.Transform3s(_turn_towards(along, length), (start + end) / 2.0))
            placed.append(shape)
        return placed


def _turn_towards(along: Array, length: float) -> Array:
    """Return a rotation (3, 3) that takes z to the direction of an axis."""
    if length <= POINT_MM:
        return NO_TURN
    x, y, z = (along / length).tolist()
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, x], [-k * x * y, 1.0 - k * y * y, y], [-x, -y, z]])
