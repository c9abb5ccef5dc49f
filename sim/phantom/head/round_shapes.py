"""Bodies that are round but not balls: capsule, rotated ellipsoid, rounded cylinder, dome, ring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.phantom.head.shapes import Bounds, Point, Values


@dataclass(frozen=True)
class Capsule:
    """A rod with round ends: everything within `radius` of the line from `start` to `end`."""

    hu: float
    start: Point
    end: Point
    radius: float

    def bounds(self) -> Bounds:
        return _box(np.minimum(self.start, self.end), np.maximum(self.start, self.end), self.radius)

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
class Egg:
    """An ellipsoid with semi-axes along the rows of `axes`; depth is first-order near its surface."""

    hu: float
    centre: Point
    semi_axes: Point
    axes: tuple[Point, Point, Point]

    def bounds(self) -> Bounds:
        return _box(np.array(self.centre), np.array(self.centre), max(self.semi_axes))

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
class Barrel:
    """A cylinder around `centre` with edges rounded by the radius `edge`."""

    hu: float
    centre: Point
    along: Point
    length: float
    radius: float
    edge: float

    def bounds(self) -> Bounds:
        half_side = float(np.hypot(self.radius, 0.5 * self.length))
        return _box(np.array(self.centre), np.array(self.centre), half_side)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        height, across = _height_and_distance(x, y, z, self.centre, self.along)
        beside = across - np.float32(self.radius - self.edge)
        above = np.abs(height) - np.float32(0.5 * self.length - self.edge)
        zero = np.float32(0.0)
        outer = np.hypot(np.maximum(beside, zero), np.maximum(above, zero))
        depth: Values = np.float32(self.edge) - outer - np.minimum(np.maximum(beside, above), zero)
        return depth


@dataclass(frozen=True)
class Dome:
    """The part of a ball beyond a plane: `height` mm above its centre, along `outward`."""

    hu: float
    centre: Point
    outward: Point
    radius: float
    height: float = 0.0

    def bounds(self) -> Bounds:
        return _box(np.array(self.centre), np.array(self.centre), self.radius)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        height, across = _height_and_distance(x, y, z, self.centre, self.outward)
        ball = np.float32(self.radius) - np.hypot(height, across)
        depth: Values = np.minimum(ball, height - np.float32(self.height))
        return depth


@dataclass(frozen=True)
class Ring:
    """A torus around an axis: `radius` to the middle of the tube, whose radius is `tube`."""

    hu: float
    centre: Point
    axis: Point
    radius: float
    tube: float

    def bounds(self) -> Bounds:
        return _box(np.array(self.centre), np.array(self.centre), self.radius + self.tube)

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
    """Height along a unit axis through `origin`, and distance from it."""
    height = _along(x, y, z, origin, np.array(axis))
    squared = sum((value - np.float32(start)) ** 2 for value, start in zip((x, y, z), origin, strict=True))
    across: Values = np.sqrt(np.maximum(squared - height * height, np.float32(0.0)))
    return height, across


def _box(low: np.ndarray, high: np.ndarray, half_side: float) -> Bounds:
    (a, b, c), (d, e, f) = (low - half_side).tolist(), (high + half_side).tolist()
    return (a, b, c), (d, e, f)
