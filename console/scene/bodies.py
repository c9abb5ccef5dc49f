"""Bodies of the 3-D scene, built from the page library's few shapes, and the closest checked pair."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from procedures.engine.events import Bodies, Body, Pose
from ronna_hw.arm.clearance.bodies import segment_distance_mm

Point = tuple[float, float, float]
Rows = list[list[float]]
METRES = 0.001  # per millimetre
CLOSE_MM = 500.0  # farther apart it is of no interest
ROUND = 16  # segments around a capsule
Call = list[Any]  # to a method of the scene, with its arguments


@dataclass(frozen=True)
class Closest:
    """Pair of bodies with the smallest clearance."""

    first: str
    second: str
    distance_mm: float
    from_mm: Point
    to_mm: Point


def axis_ends(values: tuple[float, ...]) -> tuple[Point, Point]:
    """Split six coordinates into the two endpoints of an axis."""
    a, b, c, d, e, f = values
    return (a, b, c), (d, e, f)


def rotation_along(start: Point, end: Point) -> Rows:
    """Return a row-major rotation matrix that aligns z with the direction from start to end."""
    length = math.dist(start, end)
    if length == 0.0:
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    z = tuple((e - s) / length for s, e in zip(start, end, strict=True))
    helper = (1.0, 0.0, 0.0) if abs(z[0]) < abs(z[2]) else (0.0, 0.0, 1.0)
    x = _unit(_cross(helper, z))
    y = _cross(z, x)
    return [[x[row], y[row], z[row]] for row in range(3)]


def guide_end(tool_mm: Sequence[tuple[float, ...]], entry: Point, target: Point) -> Point | None:
    """Project the tool end nearest the target onto a trajectory's axis, or return None without a tool."""
    depth_mm = math.dist(entry, target)
    shares = [
        sum((p - t) * (e - t) for p, t, e in zip(point, target, entry, strict=True)) / depth_mm**2
        for axis in tool_mm
        for point in axis_ends(axis)
    ]
    return _along(target, entry, min(shares)) if shares else None


def closest_pair(bodies: Bodies, pose: Pose) -> Closest | None:
    """Return the closest checked pair of an arm, or None if no pair is close.

    Pairs of the arm's own bodies count below the clearance of planned paths: most are as close in every pose.
    """
    if len(pose.bodies_mm) != len(bodies.moving):
        return None  # of an arm with other tools: bodies and pose are from different moments
    moving = [axis_ends(one) for one in pose.bodies_mm]
    fixed = [axis_ends(one.ends_mm) for one in bodies.fixed]
    best: Closest | None = None
    for first, second in bodies.pairs:
        a, b = moving[first]
        other = bodies.fixed[second] if second >= 0 else bodies.moving[-1 - second]
        c, d = fixed[second] if second >= 0 else moving[-1 - second]
        clearance_mm = segment_distance_mm(a, b, c, d) - bodies.moving[first].radius_mm - other.radius_mm
        counts = second >= 0 or clearance_mm < bodies.margin_mm
        if counts and clearance_mm < (best.distance_mm if best else CLOSE_MM):
            near, far = _closest_points(a, b, c, d)
            best = Closest(bodies.moving[first].name, other.name, clearance_mm, near, far)
    return best


def _closest_points(a: Point, b: Point, c: Point, d: Point) -> tuple[Point, Point]:
    """Find the closest points of two axes iteratively, accurate enough for drawing."""
    low_s, high_s = 0.0, 1.0
    for _ in range(40):  # the distance from a point to a segment is convex along the other
        third = (high_s - low_s) / 3.0
        one, two = _along(a, b, low_s + third), _along(a, b, high_s - third)
        if segment_distance_mm(one, one, c, d) < segment_distance_mm(two, two, c, d):
            high_s -= third
        else:
            low_s += third
    near = _along(a, b, (low_s + high_s) / 2.0)
    return near, _nearest_on(c, d, near)


def _nearest_on(c: Point, d: Point, point: Point) -> Point:
    direction = tuple(e - s for s, e in zip(c, d, strict=True))
    squared = sum(value * value for value in direction)
    if squared == 0.0:
        return c
    share = sum((p - s) * v for p, s, v in zip(point, c, direction, strict=True)) / squared
    return _along(c, d, min(max(share, 0.0), 1.0))


def _along(start: Point, end: Point, share: float) -> Point:
    x, y, z = (s + share * (e - s) for s, e in zip(start, end, strict=True))
    return (x, y, z)


def _cross(a: tuple[float, ...], b: tuple[float, ...]) -> Point:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _unit(a: Point) -> Point:
    length = math.hypot(*a)
    return (a[0] / length, a[1] / length, a[2] / length)


class DrawnCapsule:
    """Capsule between two points a fixed distance apart, so that moving it only takes a new pose.

    It stands at the origin of an open page until `place` has been called, and its calls are run.
    """

    def __init__(self, scene: Any, body: Body, start: Point, end: Point, colour: str, opacity: float) -> None:
        length, radius = math.dist(start, end) * METRES, body.radius_mm * METRES
        with scene.group() as self.group:
            scene.cylinder(radius, radius, length, ROUND).rotate(math.pi / 2.0, 0, 0).move(
                0, 0, length / 2.0
            ).material(colour, opacity)
            for z in (0.0, length):
                scene.sphere(radius, ROUND, ROUND // 2).move(0, 0, z).material(colour, opacity)
        self.group.with_name(body.name)

    def place(self, start: Point, end: Point) -> list[Call]:
        """Store the capsule's pose. Return the calls that place it on an open page."""
        return placing_calls(self.group, start, rotation_along(start, end))

    def delete(self) -> None:
        self.group.delete()


class DrawnRod:
    """Thin line between two points, either of which may move."""

    def __init__(self, scene: Any, radius_mm: float, colour: str) -> None:
        radius = radius_mm * METRES
        with scene.group() as self.group:
            scene.cylinder(radius, radius, 1.0, 8).rotate(math.pi / 2.0, 0, 0).move(0, 0, 0.5).material(
                colour
            )
        self.group.visible(False)

    def place(self, start: Point, end: Point) -> list[Call]:
        """Store the rod's pose and length. Return the calls that apply them on an open page."""
        length = max(math.dist(start, end) * METRES, 1e-6)
        self.group.sx, self.group.sy, self.group.sz = 1.0, 1.0, length
        self.group.visible_ = True
        scaled = ["scale", self.group.id, 1.0, 1.0, length]
        return [
            *placing_calls(self.group, start, rotation_along(start, end)),
            scaled,
            ["visible", self.group.id, True],
        ]


def placing_calls(thing: Any, at_mm: Point, rotation: Rows) -> list[Call]:
    """Store a pose for pages opened later. Return the calls that apply it on an open page."""
    thing.x, thing.y, thing.z = (value * METRES for value in at_mm)
    thing.R = rotation
    return [["move", thing.id, thing.x, thing.y, thing.z], ["rotate", thing.id, rotation]]
