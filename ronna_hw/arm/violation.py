"""A limit that a set-point or a measured pose exceeds: which one, by what, and how far."""

from __future__ import annotations

from enum import StrEnum
from math import degrees
from typing import NamedTuple


class ViolationKind(StrEnum):
    """The limit that was exceeded: of an axis, of a moving body, or, the last two, of a pair of bodies."""

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
    """What was exceeded, the value and its limit, in rad, mm and seconds.

    `axis` counts from 1. For `BODY_SPEED` it is the index in `Bodies.moving_names`, for `CLEARANCE` and
    `ZONE_SPEED` that in `Bodies.pairs`.
    """

    kind: ViolationKind
    axis: int
    value: float
    limit: float

    @property
    def of_axis(self) -> bool:
        """Whether it concerns an axis rather than bodies."""
        return self.kind not in _BODY_UNITS

    def in_units(self, value: float) -> str:
        """A value of this kind, as people read it."""
        if not self.of_axis:
            return f"{value:.1f} {_BODY_UNITS[self.kind]}"
        unit = _ANGLE_UNITS.get(self.kind)
        return f"{degrees(value):.4f} deg" if unit is None else f"{degrees(value):.1f} {unit}"

    def __str__(self) -> str:
        what = "axis" if self.of_axis else "body" if self.kind is ViolationKind.BODY_SPEED else "pair"
        value, limit = self.in_units(self.value), self.in_units(self.limit)
        return f"{self.kind} of {what} {self.axis}: {value}, limit {limit}"
