"""First guess of the sphere's outline: circles through edge points of a reduced image.

Three edge points define a circle; it counts only if the gradients at the points face its centre, as at the
rim of a bright disc. This rules out straight occluders, stains and posts. The random choice has a fixed seed,
so the same image always yields the same circles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.opencv_edges import EdgePoints

Array = NDArray[np.float64]

SEED = 20250711
TRIPLES = 4000
PORTIONS = 10  # of the triples: a clear image needs only one or two
HYPOTHESES = 100  # scored circles, at most
SCORED_POINTS = 600
FACING_START = 0.90  # cosine between gradient and the direction to the centre
FACING = 0.94
TOLERANCE_PX = 2.0  # px of the reduced image
REFINED_TOLERANCE_PX = (2.5, 1.5, 1.2)
SECTORS = 60
LEAST_COVERAGE = 0.2  # of the sectors; with less it is no circle
LEAST_POINTS = 12
CANDIDATES = 3
REFINED_CIRCLES = 8  # at most, of those that score at least ...
SCORE_SHARE = 0.3  # ... this share of the best


@dataclass(frozen=True)
class Circle:
    """Centre and radius in pixels, and the share of the rim with edges."""

    centre_px: tuple[float, float]
    radius_px: float
    coverage: float


def find_circles(edges: EdgePoints, smallest_px: float, largest_px: float) -> list[Circle]:
    """Up to three distinct circles within the radius limits, most visible rim first."""
    count = len(edges.position_px)
    if count < LEAST_POINTS:
        return []
    centres, radii = _hypotheses(edges, smallest_px, largest_px)
    scores = _scores(edges, centres, radii)
    rest = np.argsort(-scores, kind="stable")
    rest = rest[scores[rest] > SCORE_SHARE * scores.max(initial=0.0)]
    found: list[Circle] = []
    for _ in range(REFINED_CIRCLES):
        if len(rest) == 0 or len(found) == CANDIDATES:
            break
        best, rest = rest[0], rest[1:]
        circle = _refine(edges, centres[best], float(radii[best]))
        if circle is None or not smallest_px <= circle.radius_px <= largest_px:
            continue
        here = np.array([circle.centre_px]), np.array([circle.radius_px])
        if any(_same(*here, other)[0] for other in found):
            continue
        found.append(circle)
        rest = rest[~_same(centres[rest], radii[rest], circle)]
    return sorted(found, key=lambda circle: -circle.coverage * circle.radius_px)


def _hypotheses(edges: EdgePoints, smallest_px: float, largest_px: float) -> tuple[Array, Array]:
    """Circles within the limits through point triples: centres (k, 2), radii (k,)."""
    triples = np.random.default_rng(SEED).integers(0, len(edges.position_px), (TRIPLES, 3))
    centres, radii = np.empty((0, 2)), np.empty(0)
    for portion in np.split(triples, PORTIONS):
        more = _circles_through(edges, portion, smallest_px, largest_px)
        centres, radii = np.concatenate([centres, more[0]]), np.concatenate([radii, more[1]])
        if len(radii) >= HYPOTHESES:
            break
    return centres[:HYPOTHESES], radii[:HYPOTHESES]


def _circles_through(
    edges: EdgePoints, triples: NDArray[np.int64], smallest_px: float, largest_px: float
) -> tuple[Array, Array]:
    """Circles through point triples whose gradients face the centre: centres (k, 2), radii (k,)."""
    a, b, c = (edges.position_px[triples[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    doubled_area = 2.0 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    proper = np.abs(doubled_area) > 1.0
    ab, ac, a, triples = ab[proper], ac[proper], a[proper], triples[proper]
    square_ab, square_ac = (ab**2).sum(axis=1), (ac**2).sum(axis=1)
    offset = np.stack(
        [ac[:, 1] * square_ab - ab[:, 1] * square_ac, ab[:, 0] * square_ac - ac[:, 0] * square_ab], axis=1
    )
    offset /= doubled_area[proper][:, None]
    centres, radii = a + offset, np.hypot(offset[:, 0], offset[:, 1])
    kept = (radii >= smallest_px) & (radii <= largest_px)
    centres, radii, triples = centres[kept], radii[kept], triples[kept]
    for corner in range(3):  # each test leaves fewer for the next
        inward = centres - edges.position_px[triples[:, corner]]
        kept = (inward * edges.direction[triples[:, corner]]).sum(axis=1) > FACING_START * radii
        centres, radii, triples = centres[kept], radii[kept], triples[kept]
    return centres, radii


def _scores(edges: EdgePoints, centres: Array, radii: Array) -> Array:
    """Number of edge points on each circle that face its centre."""
    step = max(1, len(edges.position_px) // SCORED_POINTS)
    position = edges.position_px[::step].astype(np.float32)
    direction = edges.direction[::step].astype(np.float32)
    inward_x = centres[:, :1].astype(np.float32) - position[:, 0]
    inward_y = centres[:, 1:].astype(np.float32) - position[:, 1]
    distance = np.sqrt(inward_x * inward_x + inward_y * inward_y)
    facing = inward_x * direction[:, 0] + inward_y * direction[:, 1] > FACING * distance
    on_rim = np.abs(distance - radii[:, None].astype(np.float32)) < TOLERANCE_PX
    return np.asarray((facing & on_rim).sum(axis=1), dtype=float)


def _refine(edges: EdgePoints, centre: Array, radius: float) -> Circle | None:
    """Least-squares circle through the points on it; None when too little rim remains."""
    coverage = 0.0
    for tolerance in REFINED_TOLERANCE_PX:
        inward = centre - edges.position_px
        distance = np.hypot(inward[:, 0], inward[:, 1])
        facing = (inward * edges.direction).sum(axis=1) > FACING * distance
        chosen = facing & (np.abs(distance - radius) < tolerance)
        angle = np.arctan2(inward[chosen, 1], inward[chosen, 0])
        sectors = ((angle + np.pi) / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS
        coverage = len(np.unique(sectors)) / SECTORS
        if chosen.sum() < LEAST_POINTS or coverage < LEAST_COVERAGE:
            return None
        points = edges.position_px[chosen] - centre
        design = np.column_stack([2.0 * points, np.ones(len(points))])
        solution, *_ = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=None)
        square = solution[2] + solution[0] ** 2 + solution[1] ** 2
        centre, radius = centre + solution[:2], float(np.sqrt(max(square, 1e-12)))
    return Circle((float(centre[0]), float(centre[1])), radius, coverage)


def _same(centres: Array, radii: Array, circle: Circle) -> NDArray[np.bool_]:
    """Which of the circles (k,) are the same as this one."""
    apart = np.hypot(centres[:, 0] - circle.centre_px[0], centres[:, 1] - circle.centre_px[1])
    limit = 0.25 * np.minimum(radii, circle.radius_px)
    return np.asarray((apart < limit) & (np.abs(radii - circle.radius_px) < limit))
