"""Distances of many pairs of collision bodies at once, with NumPy: pairs as columns, capsules as segments."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ronna_hw.arm.clearance.bodies import POINT_MM2, Bodies
from ronna_hw.arrays import Array, Mask

KEPT_BODIES = 8  # surroundings in turn: stereo head, guide, with and without a corridor


class PairColumns(NamedTuple):
    """Pairs as columns: `moving` (pairs,) is the moving body of each, `thick_mm` (pairs,) the sum of radii.

    Pairs of two moving bodies are `own` (pairs,), and `partners` (own,) are their second bodies; `fixed_mm`
    (2, 3, others) are both axis ends of the fixed bodies in all others. `head` (pairs,) flags the head.
    """

    moving: NDArray[np.intp]
    own: Mask
    partners: NDArray[np.intp]
    fixed_mm: Array
    thick_mm: Array
    head: Mask


@lru_cache(KEPT_BODIES)
def list_columns(bodies: Bodies) -> PairColumns:
    """List the pairs of these bodies as columns, in their order."""
    moving = np.array([pair.moving for pair in bodies.pairs])
    other = np.array([pair.other for pair in bodies.pairs])
    own = other < 0
    partners, fixed = -1 - other[own], other[~own]
    radii_mm = np.array(bodies.moving_radii_mm)
    thick_mm = radii_mm[moving]
    thick_mm[own] += radii_mm[partners]
    thick_mm[~own] += np.array([capsule.radius_mm for capsule in bodies.fixed])[fixed]
    ends_mm = np.array([(capsule.start_mm, capsule.end_mm) for capsule in bodies.fixed])[fixed]
    head = np.array([pair.is_head for pair in bodies.pairs])
    return PairColumns(moving, own, partners, np.transpose(ends_mm, (1, 2, 0)), thick_mm, head)


def segment_distances(a: Array, b: Array, c: Array, d: Array) -> Array:
    """Return the distances (...) between the segments a-b and c-d, each (3, ...).

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
    long_u, long_v = np.maximum(uu, POINT_MM2), np.maximum(vv, POINT_MM2)
    from_c, from_a = b - c, d - a
    for offset, along, direction, square in (
        (w, vw, v, long_v),
        (from_c, _dot(from_c, v), v, long_v),
        (-w, -uw, u, long_u),
        (from_a, _dot(from_a, u), u, long_u),
    ):
        share = np.clip(along / square, 0.0, 1.0)
        rest = offset - share * direction
        least = np.minimum(least, _dot(rest, rest))
    return np.asarray(np.sqrt(least))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
