"""Adhesive ring markers in the phantom: soft rings that follow the curved skin on which they stick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ronna_hw.adhesive_marker import INNER_RADIUS_MM, OUTER_RADIUS_MM, THICKNESS_MM
from sim.phantom.head.shapes import Bounds, Shape, Values, ellipsoid_depth
from sim.world.noise import noise
from sim.world.rigid import Point
from sim.world.scene.model import Head, Scene

RING_HU = (60.0, 130.0)  # hydrogel in a foam ring: near soft tissue (unconfirmed)


@dataclass(frozen=True)
class SkinRing(Shape):
    """A ring of constant thickness on an ellipsoid's surface, around `axis` through its `centre`."""

    centre: Point
    axis: Point
    head_centre: Point
    semi_axes: Point

    def bounds(self) -> Bounds:
        reach = OUTER_RADIUS_MM + THICKNESS_MM
        x, y, z = self.centre
        return (x - reach, y - reach, z - reach), (x + reach, y + reach, z + reach)

    def depth(self, x: Values, y: Values, z: Values) -> Values:
        above = -ellipsoid_depth(x, y, z, self.head_centre, self.semi_axes)
        offsets = [value - np.float32(middle) for value, middle in zip((x, y, z), self.centre, strict=True)]
        height = sum(value * np.float32(part) for value, part in zip(offsets, self.axis, strict=True))
        squared = sum(value * value for value in offsets)
        across = np.sqrt(np.maximum(squared - height * height, np.float32(0.0)))
        thick = np.minimum(above, np.float32(THICKNESS_MM) - above)
        wide = np.minimum(across - np.float32(INNER_RADIUS_MM), np.float32(OUTER_RADIUS_MM) - across)
        # The axis passes through the far side of the head too; there is no ring there.
        return np.where(height > -OUTER_RADIUS_MM, np.minimum(thick, wide), np.float32(-1e3))


def skin_rings(scene: Scene) -> tuple[Shape, ...]:
    """Return the rings of a scene's adhesive markers."""
    generator = noise(scene.seed, "ct adhesives", 0)
    return tuple(
        _ring_on(scene.head, one.centre_ct_mm, one.normal_ct, float(generator.uniform(*RING_HU)))
        for one in scene.head.adhesives
    )


def _ring_on(head: Head, centre: Point, normal: Point, hu: float) -> Shape:
    return SkinRing(hu, centre, normal, head.centre_ct_mm, head.semi_axes_mm)
