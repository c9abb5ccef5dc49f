"""The light that arrives on a part of the sensor, before detection."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.lens import Lens

Image = NDArray[np.float32]

OUTLINE_MARGIN_PX = 3  # an outline is given by points, and a rim has a width
NEAREST_POINT_MM = 30.0  # the lens is longer than that
BAND_PIXELS = 1 << 16  # processed at a time: intermediate results fit into a processor's cache


@dataclass(frozen=True)
class Area:
    """An area of interest on the sensor, pixels."""

    x: int
    y: int
    width: int
    height: int

    def grown(self, margin: int) -> Area:
        """The area extended by a margin on all sides; may exceed the sensor."""
        return Area(self.x - margin, self.y - margin, self.width + 2 * margin, self.height + 2 * margin)

    def common(self, other: Area) -> Area:
        """The intersection of two areas; width or height are 0 if they do not overlap."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Area(x, y, max(0, right - x), max(0, bottom - y))

    @property
    def empty(self) -> bool:
        """True if it contains no pixel."""
        return self.width == 0 or self.height == 0


def row_bands(height: int, width: int) -> Iterator[slice]:
    """Rows of an image in bands.

    An operation on a whole image writes megabytes of fresh memory, which costs more than the arithmetic.
    """
    rows = max(1, BAND_PIXELS // max(1, width))
    for top in range(0, height, rows):
        yield slice(top, min(top + rows, height))


def bounds_of(lens: Lens, points_mm: NDArray[np.float64]) -> Area:
    """Area of the images of points (n, 3), with a margin for the points between; empty behind the lens."""
    points = points_mm[points_mm[:, 2] > NEAREST_POINT_MM]
    if not len(points):
        return Area(0, 0, 0, 0)
    pixels = lens.project(points)
    left, top = (floor(value) - OUTLINE_MARGIN_PX for value in pixels.min(axis=0))
    right, bottom = (ceil(value) + OUTLINE_MARGIN_PX + 1 for value in pixels.max(axis=0))
    return Area(left, top, right - left, bottom - top)


@dataclass(frozen=True)
class Canvas:
    """Light in electrons per microsecond for each pixel of `area`."""

    area: Area
    light: Image

    def part(self, area: Area) -> Image:
        """A view of the light in `area`, which must lie inside."""
        top, left = area.y - self.area.y, area.x - self.area.x
        return self.light[top : top + area.height, left : left + area.width]


class Rays:
    """The rays (x, y, 1) of all pixels of an area, linear in the pixel position.

    Distortion bends them by less than 0.1 px over a sphere's image, which is negligible for shading; at a rim
    the exact rays of the lens are used instead. Being linear, a dot product with a fixed vector is the sum of
    a row and a column, one operation per pixel.
    """

    def __init__(self, lens: Lens, area: Area) -> None:
        self.area = area
        x, y = area.x + (area.width - 1) / 2, area.y + (area.height - 1) / 2
        probe = lens.rays([[x, y], [x + 1, y], [x, y + 1]])
        self._origin = np.append(probe[0], 1.0)
        self._per_column = np.append(probe[1] - probe[0], 0.0)
        self._per_row = np.append(probe[2] - probe[0], 0.0)
        self._columns = np.arange(area.width) - (area.width - 1) / 2
        self._rows = np.arange(area.height) - (area.height - 1) / 2

    def in_rows(self, rows: slice) -> Rays:
        """The same rays for some rows only."""
        part = object.__new__(Rays)
        part.area = Area(self.area.x, self.area.y + rows.start, self.area.width, rows.stop - rows.start)
        part._origin, part._per_column, part._per_row = self._origin, self._per_column, self._per_row
        part._columns, part._rows = self._columns, self._rows[rows]
        return part

    def dot(self, vector: NDArray[np.float64]) -> Image:
        """`vector` (3,) dotted with each ray: (height, width)."""
        columns = self._columns * (self._per_column @ vector) + self._origin @ vector
        rows = self._rows * (self._per_row @ vector)
        total: Image = rows.astype(np.float32)[:, None] + columns.astype(np.float32)[None, :]
        return total

    @cached_property
    def squared(self) -> Image:
        """Squared length of each ray: (height, width)."""
        x, y = self.dot(np.array([1.0, 0.0, 0.0])), self.dot(np.array([0.0, 1.0, 0.0]))
        x *= x
        y *= y
        x += y
        x += np.float32(1.0)
        return x
