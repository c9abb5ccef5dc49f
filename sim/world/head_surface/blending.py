"""Bodies by signed distance with its gradient, and their smooth union.

Arrays may have any shapes that broadcast together, in single or double precision.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.world.rigid import Point

Values = NDArray[np.floating[Any]]


class Field(NamedTuple):
    """Signed distance, positive outside, with its gradient."""

    value: Values
    x: Values
    y: Values
    z: Values

    def inverted(self) -> Field:
        """Return the body's complement."""
        return Field(-self.value, -self.x, -self.y, -self.z)

    def distance(self) -> Values:
        """Return the distance corrected to first order by the gradient's length."""
        length = np.sqrt(self.x * self.x + self.y * self.y + self.z * self.z)
        return self.value / np.maximum(length, SHORTEST_GRADIENT)

    def normals(self) -> NDArray[np.float64]:
        """Return unit normals (n, 3) of one row of points."""
        gradient = np.column_stack([self.x, self.y, self.z])
        return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))

    def cautious(self) -> Values:
        """Return a distance that is rather too short, for steps through empty space."""
        return np.minimum(self.distance(), self.value)


SHORTEST_GRADIENT = 0.2  # deep in a crease the gradients of two bodies nearly cancel
TINY = 1e-9


def ellipsoid(x: Values, y: Values, z: Values, centre: Point, semi_axes: Point) -> Field:
    """Return an ellipsoid along the axes, its distance to first order."""
    offsets = [value - one for value, one in zip((x, y, z), centre, strict=True)]
    squares = [1.0 / axis**2 for axis in semi_axes]
    scaled = [one * square for one, square in zip(offsets, squares, strict=True)]  # half the gradient of f^2
    squared = sum(one * other for one, other in zip(offsets, scaled, strict=True))
    root = np.sqrt(squared) + TINY
    steep_squared = sum(one * one for one in scaled) + TINY * TINY
    steep = np.sqrt(steep_squared)
    value = (squared - root) / steep
    rise, bend = (2.0 - 1.0 / root) / steep, value / steep_squared
    gradient = [one * (rise - bend * square) for one, square in zip(scaled, squares, strict=True)]
    return Field(value, *gradient)


def turned_ellipsoid(
    x: Values, y: Values, z: Values, centre: tuple[Values, Values, float], semi_axes: Point, turn_rad: Values
) -> Field:
    """Return an ellipsoid turned about z through its centre; centre and turn may differ by point."""
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    dx, dy = x - centre[0], y - centre[1]
    along_x, along_y = cosine * dx + sine * dy, cosine * dy - sine * dx
    own = ellipsoid(along_x, along_y, z - centre[2], (0.0, 0.0, 0.0), semi_axes)
    return Field(own.value, cosine * own.x - sine * own.y, sine * own.x + cosine * own.y, own.z)


def cone(x: Values, y: Values, z: Values, start: Point, end: Point, radii: tuple[float, float]) -> Field:
    """Return a rod with round ends between two points, its radius growing evenly from one to the other."""
    axis = [to - of for of, to in zip(start, end, strict=True)]
    length_squared = sum(one * one for one in axis)
    offsets = [value - of for value, of in zip((x, y, z), start, strict=True)]
    raw = sum(one * along for one, along in zip(offsets, axis, strict=True)) / length_squared
    share = np.clip(raw, 0.0, 1.0)
    beside = [one - share * along for one, along in zip(offsets, axis, strict=True)]
    away = np.sqrt(sum(one * one for one in beside)) + TINY
    growth = radii[1] - radii[0]
    slope = np.where(share == raw, growth / length_squared, 0.0)
    gradient = [one / away - slope * along for one, along in zip(beside, axis, strict=True)]
    return Field(away - radii[0] - growth * share, *gradient)


def unite(one: Field, other: Field, round_mm: float) -> Field:
    """Return the union of two bodies, rounded where their distances differ by less than `round_mm`."""
    share = np.clip(0.5 + (other.value - one.value) * (0.5 / round_mm), 0.0, 1.0)  # of the first body
    rest = 1.0 - share
    value = share * one.value + rest * other.value - round_mm * share * rest
    # Where it is not clipped, the value is stationary in the share: the gradient is the plain mixture.
    return Field(
        value,
        share * one.x + rest * other.x,
        share * one.y + rest * other.y,
        share * one.z + rest * other.z,
    )


def carve(body: Field, hollow: Field, round_mm: float) -> Field:
    """Return a body without what is inside another, its edges rounded."""
    return unite(body.inverted(), hollow, round_mm).inverted()
