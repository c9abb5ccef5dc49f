"""The head as positioned in another scan: its bodies and layers in that scan's coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sim.phantom.head.layers import HeadLayers
from sim.phantom.head.shapes import Bounds, Point, Rod, Shape, Values
from sim.world.rigid import Matrix, apply, inverse

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Pose of the head: `scan_from_head` (4, 4) maps the CT frame of the plan to that of the new scan."""

    scan_from_head: Matrix

    def to_head(self, x: Values, y: Values, z: Values) -> tuple[Values, Values, Values]:
        """Scan coordinates as head coordinates; they broadcast together."""
        back = inverse(self.scan_from_head).astype(np.float32)
        u, v, w = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in back[:3])
        return u, v, w

    def rod(self, rod: Rod) -> Rod:
        """A rod in scan coordinates."""
        along = self.scan_from_head[:3, :3] @ np.array(rod.along)
        return Rod(
            rod.hu, _point(apply(self.scan_from_head, rod.start)), _point(along), rod.length, rod.radius
        )


@dataclass(frozen=True, eq=False)
class PosedShape:
    """A body of the head in the new scan."""

    shape: Shape
    pose: HeadPose

    @property
    def hu(self) -> float:
        """Its intensity."""
        return self.shape.hu

    def bounds(self) -> Bounds:
        """A bounding box of the body's rotated bounding box."""
        return self._box

    @cached_property
    def _box(self) -> Bounds:
        """Used by each slice of the scan."""
        corners = apply(self.pose.scan_from_head, list(product(*zip(*self.shape.bounds(), strict=True))))
        return _point(corners.min(axis=0)), _point(corners.max(axis=0))

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        """Signed depth in mm."""
        return self.shape.depth(*self.pose.to_head(x, y, z))


@dataclass(frozen=True, eq=False)
class PosedLayers:
    """The layers of the head in the new scan."""

    layers: HeadLayers
    pose: HeadPose

    def at(self, x: Values, y: Values, z: Values) -> Values:
        """HU at these points; air outside the head."""
        return self.layers.at(*self.pose.to_head(x, y, z))

    def bounds(self, margin_mm: float) -> Bounds:
        """A bounding box of the head, with a margin."""
        centre = apply(self.pose.scan_from_head, self.layers.centre)
        turned = self.pose.scan_from_head[:3, :3] * np.array(self.layers.semi_axes)
        half_sides = np.linalg.norm(turned, axis=1) + margin_mm
        return _point(centre - half_sides), _point(centre + half_sides)


def _point(values: Array) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
