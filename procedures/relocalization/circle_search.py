"""Initial estimate of a sphere's outline from circles through edge points of a reduced image.

Three edge points define a circle; it counts only if the gradients at the points face its centre, as at the
rim of a bright disc. This rules out straight occluders, stains and posts. The random choice has a fixed seed,
so the same image always yields the same circles.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.ellipse import circumcentre_offsets
from procedures.relocalization.grey_image import GreyImage, single_threaded
from ronna_hw.arrays import Array, Mask

SMOOTHING_PX = 1.0  # Gaussian on the reduced image, against grain
GREY_LEVELS = 255.0
NOISE_SAMPLING = 3  # every third pixel suffices to estimate the noise
STRONG_PERCENTILE = 99.5
STRONG_SHARE = 0.2  # an edge has at least this share of the strong gradients ...
NOISE_FACTOR = 6.0  # ... and this many times the typical gradient, unless that is more than ...
NOISY_SHARE = 0.5  # ... this share of the strong gradients
GRADIENT_FLOOR = 24.0  # Sobel units of an image stretched to 0..255: a step of six grey levels
WEAK_SHARE = 0.5  # Canny's lower threshold relative to the upper
# Local contrast enhancement (CLAHE): OpenCV's usual tiles, and a limit that leaves flat areas flat
CONTRAST_LIMIT, CONTRAST_TILES = 2.0, (8, 8)

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
    """Circle with centre and radius in pixels, and the fraction of its rim covered by edges."""

    centre_px: tuple[float, float]
    radius_px: float
    coverage: float


def find_circles(edges: EdgePoints, smallest_px: float, largest_px: float) -> list[Circle]:
    """Find up to three distinct circles within the radius limits, most visible rim first."""
    count = len(edges.position_px)
    if count < LEAST_POINTS:
        return []
    centres, radii = _draw_hypotheses(edges, smallest_px, largest_px)
    scores = _score_circles(edges, centres, radii)
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
        if any(_mark_same(*here, other)[0] for other in found):
            continue
        found.append(circle)
        rest = rest[~_mark_same(centres[rest], radii[rest], circle)]
    return sorted(found, key=lambda circle: -circle.coverage * circle.radius_px)


@dataclass(frozen=True)
class EdgePoints:
    """Edge pixels of a reduced image: positions x, y (n, 2) and unit gradients (n, 2), towards bright."""

    position_px: Array
    direction: Array


def equalize_contrast(image: GreyImage) -> GreyImage:
    """Enhance the contrast locally: adaptive histogram equalization with a limited gain."""
    with single_threaded():
        enhanced: GreyImage = cv2.createCLAHE(CONTRAST_LIMIT, CONTRAST_TILES).apply(image)
    return enhanced


def find_edges(image: GreyImage, dark: float, bright: float) -> EdgePoints:
    """Find thin edges after stretching the grey values from dark..bright to 0..255."""
    gain = GREY_LEVELS / max(bright - dark, 1.0)
    stretched = np.clip((image.astype(np.float32) - dark) * gain, 0.0, GREY_LEVELS).astype(np.uint8)
    with single_threaded():
        smooth = cv2.GaussianBlur(stretched, (0, 0), SMOOTHING_PX)
        slope_x = cv2.Sobel(smooth, cv2.CV_16S, 1, 0)
        slope_y = cv2.Sobel(smooth, cv2.CV_16S, 0, 1)
        upper = _edge_threshold(slope_x, slope_y)
        edges = cv2.Canny(slope_x, slope_y, WEAK_SHARE * upper, upper, L2gradient=True)
    places = cv2.findNonZero(edges)  # None if there are none; (n, 2) or (n, 1, 2) depending on the version
    position = np.asarray([] if places is None else places, dtype=np.intp).reshape(-1, 2)
    columns, rows = position[:, 0], position[:, 1]
    gradient = np.stack([slope_x[rows, columns], slope_y[rows, columns]], axis=1).astype(float)
    length = np.maximum(np.hypot(gradient[:, 0], gradient[:, 1]), 1.0)
    return EdgePoints(position.astype(float), gradient / length[:, None])


def _edge_threshold(slope_x: NDArray[np.int16], slope_y: NDArray[np.int16]) -> float:
    every = slice(None, None, NOISE_SAMPLING)
    strength = np.hypot(slope_x[every, every].astype(np.float32), slope_y[every, every].astype(np.float32))
    typical = float(np.median(strength))
    strong = float(np.percentile(strength, STRONG_PERCENTILE))
    above_noise = min(NOISE_FACTOR * typical, NOISY_SHARE * strong)  # a busy background hides no sphere
    return max(above_noise, STRONG_SHARE * strong, GRADIENT_FLOOR)


def _draw_hypotheses(edges: EdgePoints, smallest_px: float, largest_px: float) -> tuple[Array, Array]:
    """Draw point triples and fit circles within the limits: centres (k, 2), radii (k,)."""
    triples = np.random.default_rng(SEED).integers(0, len(edges.position_px), (TRIPLES, 3))
    centres, radii = np.empty((0, 2)), np.empty(0)
    for portion in np.split(triples, PORTIONS):
        more = _fit_circles(edges, portion, smallest_px, largest_px)
        centres, radii = np.concatenate([centres, more[0]]), np.concatenate([radii, more[1]])
        if len(radii) >= HYPOTHESES:
            break
    return centres[:HYPOTHESES], radii[:HYPOTHESES]


def _fit_circles(
    edges: EdgePoints, triples: NDArray[np.int64], smallest_px: float, largest_px: float
) -> tuple[Array, Array]:
    """Fit circles through point triples whose gradients face the centre: centres (k, 2), radii (k,)."""
    a, b, c = (edges.position_px[triples[:, corner]] for corner in range(3))
    offset = circumcentre_offsets(b - a, c - a, least_area=1.0)
    centres, radii = a + offset, np.hypot(offset[:, 0], offset[:, 1])
    kept = (radii >= smallest_px) & (radii <= largest_px)
    centres, radii, triples = centres[kept], radii[kept], triples[kept]
    for corner in range(3):  # each test leaves fewer for the next
        inward = centres - edges.position_px[triples[:, corner]]
        kept = (inward * edges.direction[triples[:, corner]]).sum(axis=1) > FACING_START * radii
        centres, radii, triples = centres[kept], radii[kept], triples[kept]
    return centres, radii


def _score_circles(edges: EdgePoints, centres: Array, radii: Array) -> Array:
    """Count the edge points on each circle with gradients towards its centre."""
    step = max(1, len(edges.position_px) // SCORED_POINTS)
    position = edges.position_px[::step].astype(np.float32)
    direction = edges.direction[::step].astype(np.float32)
    inward_x = centres[:, :1].astype(np.float32) - position[:, 0]
    inward_y = centres[:, 1:].astype(np.float32) - position[:, 1]
    distance = np.sqrt(inward_x * inward_x + inward_y * inward_y)
    is_facing = inward_x * direction[:, 0] + inward_y * direction[:, 1] > FACING * distance
    on_rim = np.abs(distance - radii[:, None].astype(np.float32)) < TOLERANCE_PX
    return np.asarray((is_facing & on_rim).sum(axis=1), dtype=float)


def _refine(edges: EdgePoints, centre: Array, radius: float) -> Circle | None:
    """Fit a least-squares circle to its edge points, or return None if too little of the rim is left."""
    coverage = 0.0
    for tolerance in REFINED_TOLERANCE_PX:
        inward = centre - edges.position_px
        distance = np.hypot(inward[:, 0], inward[:, 1])
        is_facing = (inward * edges.direction).sum(axis=1) > FACING * distance
        chosen = is_facing & (np.abs(distance - radius) < tolerance)
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


def _mark_same(centres: Array, radii: Array, circle: Circle) -> Mask:
    """Mark the circles (k,) that coincide with `circle`."""
    apart = np.hypot(centres[:, 0] - circle.centre_px[0], centres[:, 1] - circle.centre_px[1])
    limit = 0.25 * np.minimum(radii, circle.radius_px)
    return np.asarray((apart < limit) & (np.abs(radii - circle.radius_px) < limit))
