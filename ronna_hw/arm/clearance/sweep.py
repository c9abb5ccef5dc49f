"""Distances of all pairs of bodies over many joint vectors at once, with NumPy.

For planning. The real-time process' live monitoring has formulas of its own, so that one mistake cannot hide
in both: here the chain is multiplied out joint by joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.arm.clearance.bodies import Bodies
from ronna_hw.arm.clearance.surroundings import Corridor
from ronna_hw.devices.readings import Vector3

Array = NDArray[np.float64]

POINT_MM2 = 1e-12


@dataclass(frozen=True)
class Swept:
    """`gaps_mm` (n, pairs) between surfaces, infinite where a corridor allows contact; `to_head_mm` (n).

    `ends_mm` (n, bodies, 2, 3): both ends of every moving body's axis in $ROBROOT. `to_head_mm` is the
    smallest distance between the head and anything that moves, not negative, and infinite without a head.
    """

    ends_mm: Array
    gaps_mm: Array
    to_head_mm: Array


def sweep(bodies: Bodies, joints_rad: ArrayLike) -> Swept:
    """Bodies and distances at joint vectors (n, axes)."""
    joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
    ends = moving_ends(bodies, joints)
    pairs = bodies.pairs
    fixed = np.array([(capsule.start_mm, capsule.end_mm) for capsule in bodies.fixed])
    radii = np.array([capsule.radius_mm for capsule in bodies.fixed])
    moving = np.array([pair.moving for pair in pairs])
    other = np.array([pair.other for pair in pairs])
    moving_radii = np.array(bodies.moving_radii_mm)
    own = other < 0
    thick = moving_radii[moving]
    thick[own] += moving_radii[-1 - other[own]]
    thick[~own] += radii[other[~own]]
    axes = np.ascontiguousarray(np.transpose(ends, (2, 3, 0, 1)))  # component by component: much faster
    partner = np.empty((2, 3, len(joints), len(pairs)))
    partner[..., own] = axes[..., -1 - other[own]]
    partner[..., ~own] = np.transpose(fixed[other[~own]], (1, 2, 0))[:, :, None, :]
    first = axes[..., moving]
    gaps = segment_distances(first[0], first[1], partner[0], partner[1]) - thick
    head = np.array([pair.is_head for pair in pairs])
    to_head = np.full(len(joints), np.inf)
    if head.any():
        to_head = np.maximum(gaps[:, head].min(axis=1), 0.0)
    corridor = bodies.surroundings.corridor
    if corridor is not None:
        for column, pair in enumerate(pairs):
            if pair.enters_head and pair.is_head:
                gaps[_in_corridor(corridor, ends[:, pair.moving]), column] = np.inf
    return Swept(ends, gaps, to_head)


def moving_ends(bodies: Bodies, joints: Array) -> Array:
    """Ends of the axes of the arm's bodies and of the tool's, (n, bodies, 2, 3) mm."""
    chain = bodies.arm.chain
    origin = np.tile(np.array(chain.base_mm), (len(joints), 1))
    turn: Array | None = None
    frames = []
    for number, joint in enumerate(chain.joints):
        own = _rotation(joint.axis, joints[:, number])
        turn = own if turn is None else turn @ own
        frames.append((origin, turn))
        origin = _placed(origin, turn, joint.to_next_mm)
    assert turn is not None
    flange = origin, turn @ np.reshape(chain.flange_rotation, (3, 3))
    axes = [
        (_placed(*frames[link.joint], link.start_mm), _placed(*frames[link.joint], link.end_mm))
        for link in bodies.arm.links
    ]
    for part in bodies.surroundings.tool:
        start, end, _ = part.capsule
        axes.append((_placed(*flange, start), _placed(*flange, end)))
    return np.stack([np.stack(axis, axis=1) for axis in axes], axis=1)


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distances (...) between the segments a-b and c-d, each (3, ...).

    The smallest of five: between the lines, if their closest points are within both segments, and from each
    of the four ends to the other segment.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    uw, vw = _dot(u, w), _dot(v, w)
    across = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (uv * vw - vv * uw) / across
        t = (uu * vw - uv * uw) / across
        inside = (across > POINT_MM2 * uu * vv) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    between = w + np.where(inside, s, 0.0) * u - np.where(inside, t, 0.0) * v
    least = np.where(inside, _dot(between, between), np.inf)
    for point, origin, direction, square in ((a, c, v, vv), (b, c, v, vv), (c, a, u, uu), (d, a, u, uu)):
        offset = point - origin
        share = np.clip(_dot(offset, direction) / np.maximum(square, POINT_MM2), 0.0, 1.0)
        rest = offset - share * direction
        least = np.minimum(least, _dot(rest, rest))
    return np.asarray(np.sqrt(least))


def _in_corridor(corridor: Corridor, ends: Array) -> NDArray[np.bool_]:
    """Which of (n, 2, 3) segments are entirely in the corridor."""
    return np.array([corridor.holds(tuple(start), tuple(end)) for start, end in ends])


@cache
def _rotation_parts(axis: Vector3) -> tuple[Array, Array, Array]:
    """Parts of a rotation about a unit vector: constant, scaled by cosine, scaled by sine, (3, 3, 1)."""
    x, y, z = axis
    along = np.outer(axis, axis)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return along[:, :, None], (np.eye(3) - along)[:, :, None], across[:, :, None]


def _rotation(axis: Vector3, angles: Array) -> Array:
    """Rotation matrices (n, 3, 3) about one axis."""
    along, plane, across = _rotation_parts(axis)
    return np.moveaxis(along + np.cos(angles) * plane + np.sin(angles) * across, 2, 0)


def _placed(origin: Array, turn: Array, point_mm: Vector3) -> Array:
    """A point of a moving frame in the robot base, (n, 3)."""
    return origin + turn @ np.array(point_mm) if any(point_mm) else origin


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
