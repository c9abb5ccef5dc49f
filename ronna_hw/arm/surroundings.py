"""What the arm carries and what stands around it, as capsules: plain values for the real-time loop too.

Lengths in mm. Parts of the tool are given in the flange frame, obstacles in $ROBROOT. A `Surroundings` is
made once per tool and patient position; nothing in it changes while the arm moves.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import dist, inf
from typing import Any, NamedTuple

from ronna_hw.arm.capsule import Capsule
from ronna_hw.arm.model import ArmModel
from ronna_hw.devices.readings import Vector3

COLUMN, UPPER_ARM, FOREARM, WRIST, HAND = "base column", "upper arm", "forearm", "wrist", "hand"
OF_THE_ARM = 4  # moving bodies; those of the tool follow
FOREARM_SHARE = 0.65  # of the way from elbow to wrist centre: behind it the drives, before it the slim wrist
DEEPER_THAN_TARGET_MM = 3.0  # the corridor ends so far beyond the target: a registration may move it


class Part(NamedTuple):
    """A body of the tool, fixed to the flange. `enters_head`: it may go into the head along a corridor."""

    name: str
    capsule: Capsule
    enters_head: bool = False


class Obstacle(NamedTuple):
    """A body that stands in the room. `is_head`: speeds near it are capped, and corridors lead into it."""

    name: str
    capsule: Capsule
    is_head: bool = False


class Corridor(NamedTuple):
    """The straight way into the head: from anywhere outside over the entry to a little beyond the target."""

    entry_mm: Vector3
    target_mm: Vector3
    radius_mm: float

    def holds(self, start_mm: Vector3, end_mm: Vector3) -> bool:
        """Whether both ends of a segment, and so all of it, lie within."""
        return self._holds(start_mm) and self._holds(end_mm)

    def _holds(self, point_mm: Vector3) -> bool:
        (ex, ey, ez), depth = self.entry_mm, dist(self.entry_mm, self.target_mm)
        ax, ay, az = ((t - e) / depth for t, e in zip(self.target_mm, self.entry_mm, strict=True))
        x, y, z = point_mm[0] - ex, point_mm[1] - ey, point_mm[2] - ez
        along = x * ax + y * ay + z * az
        aside = dist((x, y, z), (along * ax, along * ay, along * az))
        return aside <= self.radius_mm and along <= depth + DEEPER_THAN_TARGET_MM


class SpeedZone(NamedTuple):
    """Largest speed of anything that moves, by the smallest distance to the head: linear between two."""

    near_mm: float
    near_speed_mm_s: float
    far_mm: float
    far_speed_mm_s: float

    def cap_mm_s(self, distance_mm: float) -> float:
        """The largest speed at a distance; constant nearer than `near_mm` and farther than `far_mm`."""
        share = (distance_mm - self.near_mm) / (self.far_mm - self.near_mm)
        share = min(max(share, 0.0), 1.0)
        return self.near_speed_mm_s + share * (self.far_speed_mm_s - self.near_speed_mm_s)


class ArmRadii(NamedTuple):
    """Thickness of the arm's bodies about their axes; own estimates on the safe side (U)."""

    column_mm: float = 150.0
    upper_arm_mm: float = 85.0
    forearm_mm: float = 70.0
    wrist_mm: float = 45.0
    hand_mm: float = 45.0


DEFAULT_RADII = ArmRadii()


class Pair(NamedTuple):
    """Two bodies that must not come close: index of the moving one, and of the other one.

    `other` counts obstacles when it is not negative; -1 - k is the moving body k.
    """

    moving: int
    other: int
    enters_head: bool
    is_head: bool


@dataclass(frozen=True)
class Surroundings:
    """All bodies, and the rules: least distance on a planned path, least distance live, speed zone."""

    tool: tuple[Part, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    radii: ArmRadii = DEFAULT_RADII
    margin_mm: float = 10.0
    live_margin_mm: float = 5.0
    zone: SpeedZone | None = None
    corridor: Corridor | None = None
    most_mm_s: float = inf  # of anything that moves, anywhere: what the operating mode allows

    def into(self, corridor: Corridor | None) -> Surroundings:
        """The same with this way into the head open, or with none."""
        return replace(self, corridor=corridor)

    def names(self, pair: Pair) -> tuple[str, str]:
        """What people call the two bodies."""
        other = self.moving_names[-1 - pair.other] if pair.other < 0 else self.all_obstacles[pair.other].name
        return self.moving_names[pair.moving], other

    @cached_property
    def moving_names(self) -> tuple[str, ...]:
        """Names of the moving bodies: those of the arm, then the parts of the tool."""
        return (UPPER_ARM, FOREARM, WRIST, HAND, *(part.name for part in self.tool))

    @cached_property
    def moving_radii_mm(self) -> tuple[float, ...]:
        """Radii of the moving bodies."""
        radii = self.radii
        return (
            radii.upper_arm_mm,
            radii.forearm_mm,
            radii.wrist_mm,
            radii.hand_mm,
            *(part.capsule.radius_mm for part in self.tool),
        )

    @cached_property
    def all_obstacles(self) -> tuple[Obstacle, ...]:
        """The arm's own column first, then what stands around."""
        return (
            Obstacle(COLUMN, Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), self.radii.column_mm)),
            *self.obstacles,
        )

    def fixed_capsules(self, model: ArmModel) -> tuple[Capsule, ...]:
        """Capsules of `all_obstacles`; the column reaches from the base to a little below A2."""
        top = max(model.base_height_mm - self.radii.column_mm, 0.0)
        column = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, top), self.radii.column_mm)
        return (column, *(obstacle.capsule for obstacle in self.obstacles))

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """Every pair that can meet. Neighbours in the chain touch by construction and are left out."""
        count = len(self.moving_names)
        enters = (*(False,) * OF_THE_ARM, *(part.enters_head for part in self.tool))
        found = [
            Pair(moving, number, enters[moving], obstacle.is_head)
            for moving in range(count)
            for number, obstacle in enumerate(self.all_obstacles)
            if not (number == 0 and moving == 0)
        ]
        found += [Pair(moving, -1, False, False) for moving in range(2, count)]
        found += [Pair(part, -2, False, False) for part in range(OF_THE_ARM, count)]
        found += [Pair(part, -3, False, False) for part in range(OF_THE_ARM, count)]
        return tuple(found)

    def cap_mm_s(self, distance_mm: float) -> float:
        """Largest speed of anything that moves at a distance from the head."""
        if self.zone is None:
            return self.most_mm_s
        return min(self.zone.cap_mm_s(distance_mm), self.most_mm_s)

    def to_json(self) -> str:
        """One line, for the real-time process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Surroundings:
        """The inverse; raises KeyError, TypeError or ValueError when the line is not from `to_json`."""
        values: dict[str, Any] = json.loads(line)
        corridor, zone = values["corridor"], values["zone"]
        return cls(
            tool=tuple(Part(name, _capsule(body), enters) for name, body, enters in values["tool"]),
            obstacles=tuple(Obstacle(name, _capsule(body), head) for name, body, head in values["obstacles"]),
            radii=ArmRadii(*values["radii"]),
            margin_mm=values["margin_mm"],
            live_margin_mm=values["live_margin_mm"],
            most_mm_s=values["most_mm_s"],
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
