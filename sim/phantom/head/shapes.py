"""Solid bodies defined by signed depth: millimetres below the surface, negative outside.

Depth is exact except for ellipsoids and cables, where it is first-order near the surface. Coordinates are CT
LPS mm; x, y and z may be any arrays that broadcast together.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from sim.world.rigid import Point, as_point

Values = NDArray[np.float32]
Bounds = tuple[Point, Point]  # lowest and highest x, y, z


@dataclass(frozen=True)
class Shape(ABC):
    """A body with uniform intensity."""

    hu: float

    @abstractmethod
    def bounds(self) -> Bounds:
        """Return a bounding box."""

    @abstractmethod
    def depth(self, x: Values, y: Values, z: Values) -> Values:
        """Return the signed depth in mm."""


@dataclass(frozen=True)
class Ball(Shape):
    """A sphere."""

    centre: Point
    radius: float

    def bounds(self) -> Bounds:
        return _around(self.centre, (self.radius,) * 3)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        cx, cy, cz = _as_float32(self.centre)
        distance: Values = np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)
        return np.float32(self.radius) - distance


@dataclass(frozen=True)
class Ellipsoid(Shape):
    """An ellipsoid aligned with x, y and z."""

    centre: Point
    semi_axes: Point

    def bounds(self) -> Bounds:
        return _around(self.centre, self.semi_axes)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        return ellipsoid_depth(x, y, z, self.centre, self.semi_axes)


@dataclass(frozen=True)
class EllipsoidShell(Shape):
    """An ellipsoidal shell of the given `thickness`."""

    centre: Point
    semi_axes: Point
    thickness: float

    def bounds(self) -> Bounds:
        a, b, c = self.semi_axes
        return _around(self.centre, (a + self.thickness, b + self.thickness, c + self.thickness))

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        outside = -ellipsoid_depth(x, y, z, self.centre, self.semi_axes)
        depth: Values = np.minimum(outside, np.float32(self.thickness) - outside)
        return depth


@dataclass(frozen=True)
class Rod(Shape):
    """A flat-ended cylinder, from `start` along the unit vector `along`."""

    start: Point
    along: Point
    length: float
    radius: float

    def bounds(self) -> Bounds:
        end = [s + self.length * a for s, a in zip(self.start, self.along, strict=True)]
        return _around_line(self.start, end, self.radius)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        sx, sy, sz = _as_float32(self.start)
        ax, ay, az = _as_float32(self.along)
        dx, dy, dz = x - sx, y - sy, z - sz
        height = dx * ax + dy * ay + dz * az
        across: Values = np.sqrt(np.maximum(dx * dx + dy * dy + dz * dz - height * height, np.float32(0.0)))
        ends: Values = np.minimum(height, np.float32(self.length) - height)
        depth: Values = np.minimum(np.float32(self.radius) - across, ends)
        return depth


@dataclass(frozen=True)
class Trough(Shape):
    """Arc of an infinite tube along z, behind the head and bounded by `half_arc_cosine`."""

    centre: Point
    inner: float
    outer: float
    half_arc_cosine: float

    def bounds(self) -> Bounds:
        return _around(self.centre, (self.outer, self.outer, inf))

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        cx, cy, _ = _as_float32(self.centre)
        dx, dy = x - cx, y - cy
        distance: Values = np.sqrt(dx * dx + dy * dy) + np.float32(0.0) * z
        wall = np.minimum(distance - np.float32(self.inner), np.float32(self.outer) - distance)
        arc = dy - np.float32(self.half_arc_cosine) * distance  # +y is towards the back of the head
        depth: Values = np.minimum(wall, arc)
        return depth


@dataclass(frozen=True)
class Slab(Shape):
    """An infinite bar along z, with corners `low` and `high` in x and y."""

    low: tuple[float, float]
    high: tuple[float, float]

    def bounds(self) -> Bounds:
        return (*self.low, -inf), (*self.high, inf)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        across = np.minimum(x - np.float32(self.low[0]), np.float32(self.high[0]) - x)
        along = np.minimum(y - np.float32(self.low[1]), np.float32(self.high[1]) - y)
        depth: Values = np.minimum(across, along) + np.float32(0.0) * z
        return depth


@dataclass(frozen=True)
class Cable(Shape):
    """A cable meandering along z, its centre swinging by `swing` at the given wavelength."""

    centre: Point
    radius: float
    swing: tuple[float, float]
    wave_length: float

    def bounds(self) -> Bounds:
        half_sides = (self.radius + abs(self.swing[0]), self.radius + abs(self.swing[1]), inf)
        return _around(self.centre, half_sides)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        cx, cy, cz = _as_float32(self.centre)
        turn = (z - cz) * np.float32(2.0 * np.pi / self.wave_length)
        dx = x - cx - np.float32(self.swing[0]) * np.sin(turn)
        dy = y - cy - np.float32(self.swing[1]) * np.cos(turn)
        # across the cable, not across its section through the slice
        slope = hypot(1.0, 2.0 * np.pi * max(map(abs, self.swing)) / self.wave_length)
        distance: Values = np.sqrt(dx * dx + dy * dy)
        return np.float32(self.radius) - distance / np.float32(slope)


def ellipsoid_depth(x: Values, y: Values, z: Values, centre: Point, semi_axes: Point) -> Values:
    """Return the depth below an ellipsoid's surface, to first order: f (1 - f) / |grad f|.

    f is the radius in semi-axes.
    """
    (cx, cy, cz), (a, b, c) = _as_float32(centre), _as_float32(semi_axes)
    u, v, w = ((x - cx) / a) ** 2, ((y - cy) / b) ** 2, ((z - cz) / c) ** 2
    squared = u + v + w
    gradient = np.sqrt(u / (a * a) + v / (b * b) + w / (c * c) + np.float32(1e-12))
    depth: Values = (np.sqrt(squared) - squared) / gradient
    return depth


def _as_float32(point: Point) -> tuple[np.float32, np.float32, np.float32]:
    x, y, z = point
    return np.float32(x), np.float32(y), np.float32(z)


def _around(centre: Point, half_sides: tuple[float, ...]) -> Bounds:
    low = [value - size for value, size in zip(centre, half_sides, strict=True)]
    high = [value + size for value, size in zip(centre, half_sides, strict=True)]
    return as_point(low), as_point(high)


def _around_line(start: Sequence[float], end: Sequence[float], radius: float) -> Bounds:
    low = [min(s, e) - radius for s, e in zip(start, end, strict=True)]
    high = [max(s, e) + radius for s, e in zip(start, end, strict=True)]
    return as_point(low), as_point(high)


@dataclass(frozen=True)
class HeadCapsule(Shape):
    """A round-ended rod: all points within `radius` of the segment from `start` to `end`."""

    start: Point
    end: Point
    radius: float

    def bounds(self) -> Bounds:
        return _around_line(self.start, self.end, self.radius)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        line = np.subtract(self.end, self.start)
        place = _along(x, y, z, self.start, line) / np.float32(max(float(line @ line), 1e-12))
        place = np.clip(place, np.float32(0.0), np.float32(1.0))
        offsets = [
            value - np.float32(start) - place * np.float32(step)
            for value, start, step in zip((x, y, z), self.start, line, strict=True)
        ]
        depth: Values = np.float32(self.radius) - np.sqrt(sum(offset**2 for offset in offsets))
        return depth


@dataclass(frozen=True)
class Egg(Shape):
    """An ellipsoid with semi-axes along the rows of `axes`, and a first-order depth near its surface."""

    centre: Point
    semi_axes: Point
    axes: tuple[Point, Point, Point]

    def bounds(self) -> Bounds:
        return _around(self.centre, (max(self.semi_axes),) * 3)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        scaled = [
            _along(x, y, z, self.centre, np.array(axis)) / np.float32(semi)
            for axis, semi in zip(self.axes, self.semi_axes, strict=True)
        ]
        squared = sum(part**2 for part in scaled)
        gradient = sum(
            (part / np.float32(semi)) ** 2 for part, semi in zip(scaled, self.semi_axes, strict=True)
        )
        return np.asarray(
            (np.sqrt(squared) - squared) / np.sqrt(gradient + np.float32(1e-12)), dtype=np.float32
        )


@dataclass(frozen=True)
class Barrel(Shape):
    """A cylinder around `centre` with edges rounded to the radius `edge`."""

    centre: Point
    along: Point
    length: float
    radius: float
    edge: float

    def bounds(self) -> Bounds:
        return _around(self.centre, (float(np.hypot(self.radius, 0.5 * self.length)),) * 3)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        height, across = _height_and_distance(x, y, z, self.centre, self.along)
        beside = across - np.float32(self.radius - self.edge)
        above = np.abs(height) - np.float32(0.5 * self.length - self.edge)
        zero = np.float32(0.0)
        outer = np.hypot(np.maximum(beside, zero), np.maximum(above, zero))
        depth: Values = np.float32(self.edge) - outer - np.minimum(np.maximum(beside, above), zero)
        return depth


@dataclass(frozen=True)
class Dome(Shape):
    """Part of a ball beyond a plane `height` mm above its centre along `outward`."""

    centre: Point
    outward: Point
    radius: float
    height: float = 0.0

    def bounds(self) -> Bounds:
        return _around(self.centre, (self.radius,) * 3)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        height, across = _height_and_distance(x, y, z, self.centre, self.outward)
        ball = np.float32(self.radius) - np.hypot(height, across)
        depth: Values = np.minimum(ball, height - np.float32(self.height))
        return depth


@dataclass(frozen=True)
class Ring(Shape):
    """A torus around an axis, with major radius `radius` and minor radius `tube`."""

    centre: Point
    axis: Point
    radius: float
    tube: float

    def bounds(self) -> Bounds:
        return _around(self.centre, (self.radius + self.tube,) * 3)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        height, across = _height_and_distance(x, y, z, self.centre, self.axis)
        depth: Values = np.float32(self.tube) - np.hypot(across - np.float32(self.radius), height)
        return depth


def _along(x: Values, y: Values, z: Values, origin: Point, direction: np.ndarray) -> Values:
    parts = [
        (value - np.float32(start)) * np.float32(part)
        for value, start, part in zip((x, y, z), origin, direction, strict=True)
    ]
    along: Values = parts[0] + parts[1] + parts[2]
    return along


def _height_and_distance(
    x: Values, y: Values, z: Values, origin: Point, axis: Point
) -> tuple[Values, Values]:
    """Return the height along a unit axis through `origin` and the distance from the axis."""
    height = _along(x, y, z, origin, np.array(axis))
    squared = sum((value - np.float32(start)) ** 2 for value, start in zip((x, y, z), origin, strict=True))
    across: Values = np.sqrt(np.maximum(squared - height * height, np.float32(0.0)))
    return height, across
