"""Occlusion: the head as an ellipsoid and the arm as capsules between marker and sensor.

Tracker frame, mm. A marker inside a body's hull is mounted on that body and protrudes from it: that
body never hides it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.world.rigid import Matrix, apply, inverse, matrix_of
from sim.world.scene.model import Head

Vectors = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Body(Protocol):
    """Something opaque."""

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        """Which of the points (n, 3) it hides from each of the eyes (m, 3): (m, n)."""
        ...


@dataclass(frozen=True)
class Ellipsoid:
    """A head: `unit_from_tracker` (4, 4) maps it to the unit sphere."""

    unit_from_tracker: Matrix

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        eyes = apply(self.unit_from_tracker, eyes_mm)[:, None]
        points = apply(self.unit_from_tracker, points_mm)
        ways = points - eyes
        # the point of each segment nearest to the centre
        share = np.clip(-(ways * eyes).sum(axis=-1) / (ways * ways).sum(axis=-1), 0.0, 1.0)
        nearest = eyes + share[..., None] * ways
        blocked = (nearest * nearest).sum(axis=-1) < 1.0
        mounted = (points * points).sum(axis=-1) < 1.0
        hidden: Flags = blocked & ~mounted
        return hidden


@dataclass(frozen=True)
class Capsules:
    """The links of an arm: everything within `radii_mm` (c,) of the segments between two (c, 3)."""

    starts_mm: Vectors
    ends_mm: Vectors
    radii_mm: Vectors

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        starts, ends, radii = self.starts_mm[:, None], self.ends_mm[:, None], self.radii_mm[:, None]
        blocked = _distances(starts, ends, eyes_mm[:, None, None], points_mm) < radii
        mounted = _distances(starts, ends, points_mm, points_mm) < radii
        hidden: Flags = np.logical_or.reduce(blocked & ~mounted, axis=1)
        return hidden


def head_ellipsoid(head: Head, tracker_from_robot: Matrix) -> Ellipsoid:
    """The head of a scene in the tracker frame."""
    ct_from_tracker = inverse(tracker_from_robot @ matrix_of(head.robot_from_ct))
    unit_from_ct = np.diag([*(1.0 / np.array(head.semi_axes_mm)), 1.0])
    unit_from_ct[:3, 3] = -np.array(head.centre_ct_mm) / head.semi_axes_mm
    return Ellipsoid(unit_from_ct @ ct_from_tracker)


def visible(eyes_mm: Vectors, points_mm: Vectors, bodies: tuple[Body, ...]) -> Flags:
    """Which points (n, 3) each of the eyes (m, 3) sees past all bodies: (m, n)."""
    seen = np.ones((len(eyes_mm), len(points_mm)), dtype=bool)
    if len(points_mm):
        for body in bodies:
            seen &= ~body.hides(eyes_mm, points_mm)
    return seen


def _distances(starts: Vectors, ends: Vectors, eyes: Vectors, points: Vectors) -> Vectors:
    """Distance between each segment start-end and each segment eye-point (Ericson 2005, 5.1.9).

    All four (..., 3), broadcast against each other.
    """
    along, ways, offsets = ends - starts, points - eyes, starts - eyes
    a = (along * along).sum(axis=-1)
    a = np.where(a > 0.0, a, 1.0)
    e = np.maximum((ways * ways).sum(axis=-1), np.finfo(float).tiny)
    b = (ways * along).sum(axis=-1)
    c = (offsets * along).sum(axis=-1)
    f = (ways * offsets).sum(axis=-1)
    denominator = a * e - b * b
    parallel = denominator < 1e-9 * a * e
    s = np.clip(np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, denominator)), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    between = starts + s[..., None] * along - (eyes + t[..., None] * ways)
    distances: Vectors = np.sqrt((between * between).sum(axis=-1))
    return distances
