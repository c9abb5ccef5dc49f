"""The tool and the surroundings of the arm as capsules: plain values, also for the real-time loop.

Lengths in mm. Parts of the tool are in the flange frame, obstacles in $ROBROOT. A `Surroundings` is created
once per tool and patient position, and is constant while the arm moves.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from math import dist, inf
from typing import Any, NamedTuple

from ronna_hw.arm.clearance.capsule import Capsule
from ronna_hw.arm.links import ArmPart
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Vector3

DEEPER_THAN_TARGET_MM = 3.0  # the corridor extends this far beyond the target, which a registration may shift


class Part(NamedTuple):
    """A body of the tool, fixed to the flange. `enters_head`: it may enter the head along a corridor."""

    name: str
    capsule: Capsule
    enters_head: bool = False


class Obstacle(NamedTuple):
    """A fixed body in the room. `is_head`: speeds near it are capped, and corridors lead into it."""

    name: str
    capsule: Capsule
    is_head: bool = False


class Corridor(NamedTuple):
    """The straight passage into the head: from outside through the entry to slightly beyond the target."""

    entry_mm: Vector3
    target_mm: Vector3
    radius_mm: float

    def holds(self, start_mm: Vector3, end_mm: Vector3) -> bool:
        """Whether both ends of a segment, and therefore all of it, are inside."""
        return self._holds(start_mm) and self._holds(end_mm)

    def _holds(self, point_mm: Vector3) -> bool:
        (ex, ey, ez), depth = self.entry_mm, dist(self.entry_mm, self.target_mm)
        ax, ay, az = ((t - e) / depth for t, e in zip(self.target_mm, self.entry_mm, strict=True))
        x, y, z = point_mm[0] - ex, point_mm[1] - ey, point_mm[2] - ez
        along = x * ax + y * ay + z * az
        aside = dist((x, y, z), (along * ax, along * ay, along * az))
        return aside <= self.radius_mm and along <= depth + DEEPER_THAN_TARGET_MM


class SpeedZone(NamedTuple):
    """Speed limit for everything that moves, linear in the distance to the head between two points."""

    near_mm: float
    near_speed_mm_s: float
    far_mm: float
    far_speed_mm_s: float

    def cap_mm_s(self, distance_mm: float) -> float:
        """The speed limit at a distance; constant closer than `near_mm` and farther than `far_mm`."""
        share = (distance_mm - self.near_mm) / (self.far_mm - self.near_mm)
        share = min(max(share, 0.0), 1.0)
        return self.near_speed_mm_s + share * (self.far_speed_mm_s - self.near_speed_mm_s)


class ArmRadii(NamedTuple):
    """Radii of the arm's bodies about their axes; our own conservative estimates (U)."""

    column_mm: float = 150.0
    upper_arm_mm: float = 85.0
    forearm_mm: float = 70.0
    wrist_mm: float = 45.0
    hand_mm: float = 45.0

    def of(self, part: ArmPart) -> float:
        """The radius of a part."""
        return self[_PARTS.index(part)]


_PARTS = (ArmPart.COLUMN, ArmPart.UPPER_ARM, ArmPart.FOREARM, ArmPart.WRIST, ArmPart.HAND)

DEFAULT_RADII = ArmRadii()


@dataclass(frozen=True)
class Surroundings:
    """All bodies, and the rules: minimum distance on a planned path, minimum distance live, speed zone."""

    tool: tuple[Part, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    radii: ArmRadii = DEFAULT_RADII
    margin_mm: float = 10.0
    live_margin_mm: float = 5.0
    zone: SpeedZone | None = None
    corridor: Corridor | None = None

    def moved(self, by: Pose) -> Surroundings:
        """The same with everything fixed in the room moved."""
        corridor = self.corridor
        return replace(
            self,
            obstacles=tuple(one._replace(capsule=one.capsule.moved(by)) for one in self.obstacles),
            corridor=corridor
            and corridor._replace(
                entry_mm=by.apply(corridor.entry_mm), target_mm=by.apply(corridor.target_mm)
            ),
        )

    def cap_mm_s(self, distance_mm: float) -> float:
        """Speed limit of anything that moves at a distance from the head; infinite without a zone."""
        return inf if self.zone is None else self.zone.cap_mm_s(distance_mm)

    def to_json(self) -> str:
        """One line, for the real-time process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Surroundings:
        """The inverse; raises KeyError, TypeError or ValueError if the line is not from `to_json`."""
        values: dict[str, Any] = json.loads(line)
        corridor, zone = values["corridor"], values["zone"]
        return cls(
            tool=tuple(Part(name, _capsule(body), enters) for name, body, enters in values["tool"]),
            obstacles=tuple(Obstacle(name, _capsule(body), head) for name, body, head in values["obstacles"]),
            radii=ArmRadii(*values["radii"]),
            margin_mm=values["margin_mm"],
            live_margin_mm=values["live_margin_mm"],
            zone=None if zone is None else SpeedZone(*zone),
            corridor=None
            if corridor is None
            else Corridor(_three(corridor[0]), _three(corridor[1]), corridor[2]),
        )


def _capsule(values: Any) -> Capsule:
    start, end, radius = values
    return Capsule(_three(start), _three(end), float(radius))


def _three(values: Any) -> Vector3:
    x, y, z = values
    return (float(x), float(y), float(z))
