"""Occlusion: the head as an ellipsoid and the arm as capsules between marker and sensor.

Tracker frame, mm. A marker inside a body's hull is mounted on that body and stands out of it: that body
never hides it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.theatre.rigid import Matrix, apply, inverse, matrix_of
from sim.theatre.scene.model import Head

Vectors = NDArray[np.float64]
Flags = NDArray[np.bool_]


class Body(Protocol):
    """An opaque body."""

    def hides(self, eye_mm: Vectors, points_mm: Vectors) -> Flags:
        """Which of the points (n, 3) this body hides from an eye (3,)."""
        ...


@dataclass(frozen=True)
class Ellipsoid:
    """A head: `unit_from_tracker` (4, 4) maps it to the unit sphere."""

    unit_from_tracker: Matrix

    def hides(self, eye_mm: Vectors, points_mm: Vectors) -> Flags:
        eye = apply(self.unit_from_tracker, eye_mm)
        points = apply(self.unit_from_tracker, points_mm)
        ways = points - eye
        # the point of each segment nearest to the centre
        share = np.clip(-(ways @ eye) / (ways * ways).sum(axis=1), 0.0, 1.0)
        nearest = eye + share[:, None] * ways
        blocked = (nearest * nearest).sum(axis=1) < 1.0
        mounted = (points * points).sum(axis=1) < 1.0
        hidden: Flags = blocked & ~mounted
        return hidden


@dataclass(frozen=True)
class Capsule:
    """A link of the arm: everything within `radius_mm` of the segment from `start_mm` to `end_mm`."""

    start_mm: Vectors
    end_mm: Vectors
    radius_mm: float

    def hides(self, eye_mm: Vectors, points_mm: Vectors) -> Flags:
        blocked = _distances(self.start_mm, self.end_mm, eye_mm, points_mm) < self.radius_mm
        mounted = _distances(self.start_mm, self.end_mm, points_mm, points_mm) < self.radius_mm
        hidden: Flags = blocked & ~mounted
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
        for row, eye in zip(seen, eyes_mm, strict=True):
            for body in bodies:
                row &= ~body.hides(eye, points_mm)
    return seen


def _distances(start: Vectors, end: Vectors, eyes: Vectors, points: Vectors) -> Vectors:
    """Distance (n,) between segment start-end and each segment eye-point (Ericson 2005, 5.1.9)."""
    along, ways, offsets = end - start, points - eyes, start - eyes
    a = float(along @ along) or 1.0
    e = np.maximum((ways * ways).sum(axis=-1), np.finfo(float).tiny)
    b = ways @ along
    c = (np.broadcast_to(offsets, ways.shape)) @ along
    f = (ways * offsets).sum(axis=-1)
    denominator = a * e - b * b
    parallel = denominator < 1e-9 * a * e
    s = np.clip(np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, denominator)), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    between = start + s[:, None] * along - (eyes + t[:, None] * ways)
    distances: Vectors = np.sqrt((between * between).sum(axis=1))
    return distances
