"""Collision bodies of the arm, its tool and its surroundings, as plain values.

Capsules are the only shape: all points within a radius of a segment. Everything else is covered by capsules,
so one closed formula gives every distance. The real-time loop uses it: no NumPy.

Lengths in mm. Parts of the tool are in the flange frame, obstacles in $ROBROOT. A `Surroundings` is created
once per tool and patient position, and is constant while the arm moves.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from math import dist, hypot, inf, sqrt
from typing import Any, NamedTuple

from ronna_hw.arm.kinematics import COLUMN_NAME, PARTS, ArmBodies, ArmPart
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import Vector3, vector3

POINT_MM2 = 1e-12  # a segment shorter than a nanometre is a point


class Capsule(NamedTuple):
    """Capsule defined by an axis segment and a radius, in mm. Coincident ends make a sphere."""

    start_mm: Vector3
    end_mm: Vector3
    radius_mm: float

    def moved(self, pose: Pose) -> Capsule:
        """Return the capsule in the target frame of `pose`."""
        return Capsule(pose.apply(self.start_mm), pose.apply(self.end_mm), self.radius_mm)


def segment_distance_mm(a: Vector3, b: Vector3, c: Vector3, d: Vector3) -> float:
    """Return the distance in mm between the segments a-b and c-d."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = d[0] - c[0], d[1] - c[1], d[2] - c[2]
    wx, wy, wz = a[0] - c[0], a[1] - c[1], a[2] - c[2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
    if vv <= POINT_MM2:
        t = 0.0
        s = -uw / uu if uu > POINT_MM2 else 0.0
    elif uu <= POINT_MM2:
        s, t = 0.0, vw / vv
    else:
        uv = ux * vx + uy * vy + uz * vz
        across = uu * vv - uv * uv
        s = (uv * vw - vv * uw) / across if across > POINT_MM2 * uu * vv else 0.0
        s = 0.0 if s < 0.0 else 1.0 if s > 1.0 else s
        t = (uv * s + vw) / vv
        if not 0.0 <= t <= 1.0:
            t = 0.0 if t < 0.0 else 1.0
            s = (uv * t - uw) / uu
    s = 0.0 if s < 0.0 else 1.0 if s > 1.0 else s
    t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return sqrt(x * x + y * y + z * z)


def covering_ellipsoid(semi_axes_mm: Vector3, pose: Pose) -> tuple[Capsule, Capsule]:
    """Enclose an ellipsoid in two parallel capsules along its longest axis, offset along the middle axis.

    The radius is the smallest at which the balls at the segments' ends cover the ellipsoid's ends and the
    capsules meet in its middle. They exceed its surface by some per cent of the differences between the axes.
    `pose` maps from the ellipsoid's own frame (origin at its centre, along its axes).
    """
    order = sorted(range(3), key=lambda axis: semi_axes_mm[axis])
    short, middle, long = (semi_axes_mm[axis] for axis in order)
    aside = (middle * middle - short * short) / (2.0 * middle)
    along = (long * long - short * short) / (2.0 * long)
    radius = max(hypot(short, aside), hypot(aside, long - along), middle - aside)

    def corner(side: float, end: float) -> Vector3:
        place = [0.0, 0.0, 0.0]
        place[order[1]], place[order[2]] = side * aside, end * along
        return pose.apply((place[0], place[1], place[2]))

    return (
        Capsule(corner(-1.0, -1.0), corner(-1.0, 1.0), radius),
        Capsule(corner(1.0, -1.0), corner(1.0, 1.0), radius),
    )


# Safety against a needle outside its corridor beyond the target (U).
DEEPER_THAN_TARGET_MM = 3.0  # the corridor extends this far beyond the target, which a registration may shift


class Part(NamedTuple):
    """Tool collision body, rigidly attached to the flange.

    `enters_head`: it may enter the head along a corridor.
    """

    name: str
    capsule: Capsule
    enters_head: bool = False


class Obstacle(NamedTuple):
    """Fixed collision body in the room. `is_head` caps speeds nearby and lets the corridor lead into it."""

    name: str
    capsule: Capsule
    is_head: bool = False


class Corridor(NamedTuple):
    """Straight passage into the head, from outside through the entry to slightly beyond the target."""

    entry_mm: Vector3
    target_mm: Vector3
    radius_mm: float

    def holds(self, start_mm: Vector3, end_mm: Vector3) -> bool:
        """Whether a segment lies entirely inside the corridor."""
        return self._contains_point(start_mm) and self._contains_point(end_mm)

    def _contains_point(self, point_mm: Vector3) -> bool:
        (ex, ey, ez), depth = self.entry_mm, dist(self.entry_mm, self.target_mm)
        ax, ay, az = ((t - e) / depth for t, e in zip(self.target_mm, self.entry_mm, strict=True))
        x, y, z = point_mm[0] - ex, point_mm[1] - ey, point_mm[2] - ez
        along = x * ax + y * ay + z * az
        aside = dist((x, y, z), (along * ax, along * ay, along * az))
        return aside <= self.radius_mm and along <= depth + DEEPER_THAN_TARGET_MM


class SpeedZone(NamedTuple):
    """Speed limit for all moving bodies, interpolated linearly over the distance to the head."""

    near_mm: float
    near_speed_mm_s: float
    far_mm: float
    far_speed_mm_s: float

    def cap_mm_s(self, distance_mm: float) -> float:
        """Return the speed limit in mm/s at a distance; constant below `near_mm` and above `far_mm`."""
        share = (distance_mm - self.near_mm) / (self.far_mm - self.near_mm)
        share = min(max(share, 0.0), 1.0)
        return self.near_speed_mm_s + share * (self.far_speed_mm_s - self.near_speed_mm_s)


class MeasuredRadii(NamedTuple):
    """Capsule radii of the arm's bodies as the theatre file gives them; None is the arm's own."""

    column_mm: float | None = None
    upper_arm_mm: float | None = None
    forearm_mm: float | None = None
    wrist_mm: float | None = None
    hand_mm: float | None = None

    def of(self, part: ArmPart, arm: ArmBodies) -> float:
        """Return the radius of a part, mm."""
        measured = self[PARTS.index(part)]
        return arm.radii.of(part) if measured is None else measured


ARMS_OWN_RADII = MeasuredRadii()


@dataclass(frozen=True)
class Surroundings:
    """Collision bodies around the arm, with the minimum distances (planned and live) and the speed zone.

    With several arms, messages name the bodies of this one after its `owner`. `contacts` are the names of a
    moving body and an obstacle that may come close to each other.
    """

    tool: tuple[Part, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    radii: MeasuredRadii = ARMS_OWN_RADII
    margin_mm: float = 10.0
    live_margin_mm: float = 5.0
    zone: SpeedZone | None = None
    corridor: Corridor | None = None
    owner: str = ""
    contacts: tuple[tuple[str, str], ...] = ()

    def moved(self, by: Pose) -> Surroundings:
        """Return a copy with all room-fixed bodies and the corridor transformed."""
        corridor = self.corridor
        return replace(
            self,
            obstacles=tuple(item._replace(capsule=item.capsule.moved(by)) for item in self.obstacles),
            corridor=corridor
            and corridor._replace(
                entry_mm=by.apply(corridor.entry_mm), target_mm=by.apply(corridor.target_mm)
            ),
        )

    def thickened(self, by_mm: float) -> Surroundings:
        """Return a copy with all room-fixed bodies thicker."""
        return replace(
            self,
            obstacles=tuple(
                item._replace(capsule=item.capsule._replace(radius_mm=item.capsule.radius_mm + by_mm))
                for item in self.obstacles
            ),
        )

    def cap_mm_s(self, distance_mm: float) -> float:
        """Return the speed limit in mm/s at a distance from the head; infinite without a speed zone."""
        return inf if self.zone is None else self.zone.cap_mm_s(distance_mm)

    def to_json(self) -> str:
        """Encode as one line of JSON for the real-time process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> Surroundings:
        """Decode a line written by `to_json`; raises KeyError, TypeError or ValueError for any other line."""
        values: dict[str, Any] = json.loads(line)
        corridor, zone = values["corridor"], values["zone"]
        return cls(
            tool=tuple(Part(name, _capsule(body), enters) for name, body, enters in values["tool"]),
            obstacles=tuple(Obstacle(name, _capsule(body), head) for name, body, head in values["obstacles"]),
            radii=MeasuredRadii(*values["radii"]),
            margin_mm=values["margin_mm"],
            live_margin_mm=values["live_margin_mm"],
            zone=None if zone is None else SpeedZone(*zone),
            corridor=None
            if corridor is None
            else Corridor(vector3(corridor[0]), vector3(corridor[1]), corridor[2]),
            owner=str(values["owner"]),
            contacts=tuple((str(moving), str(other)) for moving, other in values["contacts"]),
        )


def _capsule(values: Any) -> Capsule:
    start, end, radius = values
    return Capsule(vector3(start), vector3(end), float(radius))


class Pair(NamedTuple):
    """Pair of bodies to keep apart, by index: a moving body and any other body.

    A non-negative `other` is the index of a fixed body; -1 - k is the moving body k.
    """

    moving: int
    other: int
    enters_head: bool
    is_head: bool


@dataclass(frozen=True)
class Bodies:
    """All collision bodies: moving (links, then tool parts) and fixed (column, then obstacles)."""

    arm: ArmBodies
    surroundings: Surroundings

    def names(self, pair: Pair) -> tuple[str, str]:
        """Return the names of the two bodies of a pair, those of the arm with its owner."""
        if pair.other < 0:
            other = self._own(self.moving_names[-1 - pair.other])
        elif pair.other == 0:
            other = self._own(COLUMN_NAME)
        else:
            other = self.surroundings.obstacles[pair.other - 1].name
        return self._own(self.moving_names[pair.moving]), other

    def _own(self, name: str) -> str:
        owner = self.surroundings.owner
        return f"{name} of the {owner}" if owner else name

    @cached_property
    def moving_names(self) -> tuple[str, ...]:
        """Names of the moving bodies."""
        return (*(link.name for link in self.arm.links), *(part.name for part in self.surroundings.tool))

    @cached_property
    def moving_radii_mm(self) -> tuple[float, ...]:
        """Radii of the moving bodies."""
        radii = self.surroundings.radii
        return (
            *(radii.of(link.part, self.arm) for link in self.arm.links),
            *(part.capsule.radius_mm for part in self.surroundings.tool),
        )

    @cached_property
    def fixed(self) -> tuple[Capsule, ...]:
        """Fixed bodies: the column, then the obstacles.

        The column ends slightly below the first moving body.
        """
        radius_mm = self.surroundings.radii.of(ArmPart.COLUMN, self.arm)
        top_mm = max(self.arm.column_height_mm - radius_mm, 0.0)
        column = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, top_mm), radius_mm)
        return (column, *(obstacle.capsule for obstacle in self.surroundings.obstacles))

    @cached_property
    def pairs(self) -> tuple[Pair, ...]:
        """Pairs of bodies that can collide, excluding those in contact by design."""
        links, tool = self.arm.links, self.surroundings.tool
        obstacles = self.surroundings.obstacles
        names, contacts = self.moving_names, frozenset(self.surroundings.contacts)
        count = len(links)
        touches = (*(link.touches for link in links), *((links[-1].name,) for _ in tool))
        enters = (*(False,) * count, *(part.enters_head for part in tool))
        listed_pairs = []
        for moving, touched in enumerate(touches):
            if COLUMN_NAME not in touched:
                listed_pairs.append(Pair(moving, 0, enters[moving], False))
            listed_pairs += [
                Pair(moving, number, enters[moving], obstacle.is_head)
                for number, obstacle in enumerate(obstacles, start=1)
                if (names[moving], obstacle.name) not in contacts
            ]
        for inner, link in enumerate(links):
            listed_pairs += [
                Pair(moving, -1 - inner, False, False)
                for moving in range(inner + 1, len(touches))
                if link.name not in touches[moving]
            ]
        return tuple(listed_pairs)
