"""Distances of all pairs of bodies over many joint vectors at once, with NumPy.

For planning. The live watch of the real-time process has formulas of its own, so that one mistake cannot hide
in both: here the chain is multiplied out joint by joint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.arm.model import ArmModel
from ronna_hw.arm.surroundings import FOREARM_SHARE, Surroundings

Array = NDArray[np.float64]

POINT_MM2 = 1e-12


@dataclass(frozen=True)
class Swept:
    """`gaps_mm` (n, pairs) between surfaces, infinite where a corridor allows the contact; `to_head_mm` (n).

    `ends_mm` (n, bodies, 2, 3): both ends of every moving body's axis in $ROBROOT. `to_head_mm` is the
    smallest distance of anything that moves to the head, not negative, and infinite where there is no head.
    """

    ends_mm: Array
    gaps_mm: Array
    to_head_mm: Array


def sweep(model: ArmModel, surroundings: Surroundings, joints_rad: ArrayLike) -> Swept:
    """Bodies and distances at joint vectors (n, 6)."""
    joints = np.atleast_2d(np.asarray(joints_rad, dtype=float))
    ends = moving_ends(model, surroundings, joints)
    pairs = surroundings.pairs
    capsules = surroundings.fixed_capsules(model)
    fixed = np.array([(capsule.start_mm, capsule.end_mm) for capsule in capsules])
    radii = np.array([capsule.radius_mm for capsule in capsules])
    moving = np.array([pair.moving for pair in pairs])
    other = np.array([pair.other for pair in pairs])
    moving_radii = np.array(surroundings.moving_radii_mm)
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
    if surroundings.corridor is not None:
        for column, pair in enumerate(pairs):
            if pair.enters_head and pair.is_head:
                gaps[_in_corridor(surroundings, ends[:, pair.moving]), column] = np.inf
    return Swept(ends, gaps, to_head)


def moving_ends(model: ArmModel, surroundings: Surroundings, joints: Array) -> Array:
    """Ends of the axes of the arm's bodies and of the tool's, (n, bodies, 2, 3) mm."""
    A1, A2, A3, A4, A5, A6 = joints.T
    turn = _turn("z", -A1)
    shoulder = _reach(turn, (model.shoulder_offset_mm, 0.0, 0.0))
    shoulder[:, 2] += model.base_height_mm
    turn = turn @ _turn("y", A2)
    elbow = shoulder + _reach(turn, (model.upper_arm_mm, 0.0, 0.0))
    turn = turn @ _turn("y", A3)
    beside = elbow + _reach(turn, (0.0, 0.0, model.elbow_offset_mm))
    wrist = beside + _reach(turn, (model.forearm_mm, 0.0, 0.0))
    turn = turn @ _turn("x", -A4) @ _turn("y", A5) @ _turn("x", -A6)
    flange = wrist + _reach(turn, (model.flange_mm, 0.0, 0.0))
    # The flange frame is turned by 90 degrees about y: its x is the link's -z, its z the link's x.
    turn = turn @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    slim = beside + FOREARM_SHARE * (wrist - beside)
    bodies = [(shoulder, elbow), (beside, slim), (slim, wrist), (wrist, flange)]
    for part in surroundings.tool:
        start, end, _ = part.capsule
        bodies.append((flange + _reach(turn, start), flange + _reach(turn, end)))
    return np.stack([np.stack(body, axis=1) for body in bodies], axis=1)


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Distances (...) of the segments a-b and c-d, each (3, ...).

    The smallest of five: between the lines where their closest points lie within both segments, and of each
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


def _in_corridor(surroundings: Surroundings, ends: Array) -> NDArray[np.bool_]:
    """Which of (n, 2, 3) segments lie wholly in the corridor."""
    corridor = surroundings.corridor
    assert corridor is not None
    return np.array([corridor.holds(tuple(start), tuple(end)) for start, end in ends])


def _turn(axis: str, angles: Array) -> Array:
    """Rotation matrices (n, 3, 3) about one axis."""
    c, s = np.cos(angles), np.sin(angles)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = {
        "x": [[one, zero, zero], [zero, c, -s], [zero, s, c]],
        "y": [[c, zero, s], [zero, one, zero], [-s, zero, c]],
        "z": [[c, -s, zero], [s, c, zero], [zero, zero, one]],
    }[axis]
    return np.moveaxis(np.array(rows), 2, 0)


def _reach(turn: Array, vector: ArrayLike) -> Array:
    return np.asarray(turn @ np.asarray(vector, dtype=float))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
