"""Capsules, the only shape of the collision geometry, and the distance between two of them, in plain floats.

A capsule is the set of points within a radius of a segment. Everything else is covered by capsules, so that a
single closed formula suffices. Used in the real-time loop: no NumPy.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import NamedTuple

from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Vector3

POINT_MM2 = 1e-12  # a segment shorter than a nanometre is a point


class Capsule(NamedTuple):
    """Segment and radius, mm. Equal ends make a ball."""

    start_mm: Vector3
    end_mm: Vector3
    radius_mm: float

    def moved(self, pose: Pose) -> Capsule:
        """The capsule in the target frame of `pose`."""
        return Capsule(pose.apply(self.start_mm), pose.apply(self.end_mm), self.radius_mm)


def segment_distance_mm(a: Vector3, b: Vector3, c: Vector3, d: Vector3) -> float:
    """Distance between segments a-b and c-d: closest points of the lines, clamped in turn to the segments."""
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
    """Two capsules that cover an ellipsoid, along its longest axis, side by side along the middle one.

    The radius is the smallest for which the balls at the ends of the segments cover the ellipsoid's ends and
    the two capsules meet in its middle; they exceed its surface by some per cent of the differences between
    the axes. `pose` maps from the ellipsoid's frame (origin at its centre, along its axes) to the wanted one.
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
