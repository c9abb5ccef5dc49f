"""The thesis' pipeline, step 6: a centre from two lines, or from a sphere, both by RANSAC.

LineFit: one line through the circle centres of each stack; the centre is the point nearest to both.
SphereFit: a sphere through points of all circles. Samples are drawn with a fixed seed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.thesis.clusters import Cluster

Array = NDArray[np.float64]

TRIALS = 200
LINE_TOLERANCE_MM = 0.5
SPHERE_TOLERANCE_MM = 0.3
POINTS_PER_CIRCLE = 24
SEED = 0


def fit_lines(axial: Cluster, sagittal: Cluster) -> Array:
    """The point (3,) grid mm nearest to the lines through both clusters' centres."""
    (p, u), (q, v) = (_fit_line(cluster.centres_mm) for cluster in (axial, sagittal))
    offset, cosine = q - p, float(u @ v)
    # the feet of the common perpendicular
    along_u = (offset @ u - cosine * (offset @ v)) / (1.0 - cosine**2)
    along_v = (cosine * (offset @ u) - offset @ v) / (1.0 - cosine**2)
    return np.asarray(0.5 * (p + along_u * u + q + along_v * v))


def fit_sphere(axial: Cluster, sagittal: Cluster) -> tuple[Array, float, float]:
    """Centre (3,) grid mm, radius mm, and the share of circle points on the sphere."""
    points = np.concatenate([_circle_points(cluster) for cluster in (axial, sagittal)])
    random = np.random.default_rng(SEED)
    best = np.zeros(len(points), dtype=bool)
    for _ in range(TRIALS):
        chosen = points[random.choice(len(points), 4, replace=False)]
        centre, radius = _algebraic_sphere(chosen)
        inlying = np.abs(np.linalg.norm(points - centre, axis=1) - radius) < SPHERE_TOLERANCE_MM
        if inlying.sum() > best.sum():
            best = inlying
    if best.sum() < 4:
        best[:] = True
    centre, radius = _algebraic_sphere(points[best])
    return centre, radius, float(best.mean())


def _fit_line(points: Array) -> tuple[Array, Array]:
    """A point on the line and its unit direction."""
    random = np.random.default_rng(SEED)
    best = np.zeros(len(points), dtype=bool)
    for _ in range(TRIALS):
        first, second = points[random.choice(len(points), 2, replace=False)]
        direction = second - first
        direction = direction / np.linalg.norm(direction)
        offsets = points - first
        beside = np.linalg.norm(offsets - np.outer(offsets @ direction, direction), axis=1)
        if (beside < LINE_TOLERANCE_MM).sum() > best.sum():
            best = beside < LINE_TOLERANCE_MM
    middle = points[best].mean(axis=0)
    _, _, axes = np.linalg.svd(points[best] - middle)
    return middle, axes[0]


def _circle_points(cluster: Cluster) -> Array:
    angle = 2.0 * np.pi * np.arange(POINTS_PER_CIRCLE) / POINTS_PER_CIRCLE
    first, second = (other for other in range(3) if other != cluster.axis)
    ring = np.zeros((POINTS_PER_CIRCLE, 3))
    ring[:, first], ring[:, second] = np.cos(angle), np.sin(angle)
    points = cluster.centres_mm[:, None, :] + cluster.radii_mm[:, None, None] * ring[None]
    return np.asarray(points.reshape(-1, 3))


def _algebraic_sphere(points: Array) -> tuple[Array, float]:
    """|x|² = 2 c·x + (R² - |c|²), by least squares, relative to the mean of the points."""
    middle = points.mean(axis=0)
    offsets = points - middle
    design = np.column_stack([2.0 * offsets, np.ones(len(points))])
    solved, *_ = np.linalg.lstsq(design, (offsets**2).sum(axis=1), rcond=None)
    centre = solved[:3]
    return centre + middle, float(np.sqrt(max(solved[3] + centre @ centre, 0.0)))
