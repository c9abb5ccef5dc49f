"""Combines two estimates of one centre, with a realistic covariance.

The estimators see the same noise, so their errors are correlated; where they differ by more than their noise
explains, something in the image fits neither model, and the difference is added to the covariance. A streak
band across the ball can pull the model's radius and intensities far off, and its centre with them. Edges
found by rays cannot move that far, so they alone then determine centre and radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.sphere_centre.blurred_ball import BlurredBall
from procedures.imaging.sphere_centre.radial_edge import RadialEdge

Array = NDArray[np.float64]

# measured on synthetic spheres, noise 20 and 50 HU, voxels of 0.5 x 0.5 x 1 and 0.7 x 0.7 x 2 mm
RAY_CORRELATION = 2.0  # neighbouring rays share voxels: variance relative to independent rays
INTERPOLATION_ERROR_PER_MM = 0.004  # mm of error per mm² of voxel size, from interpolation between voxels
SLICE_PROFILE_ERROR_PER_MM = 0.0003  # mm per mm²: a voxel is a box, the model's blur a Gaussian
ERROR_CORRELATION = 0.6  # between the errors of the two estimators
# Streaks move the edges found by rays: 3-D error for bend terms as large as the contrast. From the tuning
# families and synthetic bands and lobes on `plain`.
EDGE_STREAK_ERROR_MM = 2.0
# By how much of it the ball's radius exceeds that of the edges, with film and blur, in an undisturbed fit:
# 0.03 to 0.13 mm on the tuning families. Bands make it -0.16 to 1.8 mm.
RADIUS_ABOVE_EDGES = (-0.005, 0.026)
AGREEMENT_MM = 0.06  # beyond this the two estimators contradict each other
STREAKED = 0.0075  # bend terms relative to the contrast: up to 0.004 without streaks
ENOUGH_SURFACE = 0.7  # for the edges to be used alone


@dataclass(frozen=True, eq=False)
class CombinedCentre:
    """Centre and covariance in grid mm (slice, row, column); `agreement_mm` between the two estimates."""

    centre_mm: Array
    covariance_mm2: Array
    agreement_mm: float
    radius_mm: float


def combine(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> CombinedCentre:
    """The minimum-variance mean of both estimates (generalized least squares with cross-covariance)."""
    if _is_spoiled(edge, ball):
        return _by_edges(edge, ball, spacing_mm)
    first = _edge_covariance(edge, spacing_mm, ball.streak_hu / abs(ball.contrast_hu))
    second = ball.covariance_mm2 + np.diag((SLICE_PROFILE_ERROR_PER_MM * spacing_mm**2) ** 2)
    # an estimate that adds no information gets zero weight rather than a negative one
    correlation = min(ERROR_CORRELATION, float(np.sqrt(np.trace(second) / np.trace(first))))
    cross = correlation * _root(first) @ _root(second)
    difference = edge.centre_mm - ball.centre_mm
    spread = first + second - cross - cross.T  # covariance of the difference
    gain = (second - cross.T) @ np.linalg.inv(spread)
    centre_mm = ball.centre_mm + gain @ difference
    covariance = second - gain @ (second - cross)
    excess = max(0.0, float(difference @ difference) - float(np.trace(spread)))
    if excess > 0.0:
        direction = difference / np.linalg.norm(difference)
        covariance = covariance + 0.0625 * excess * (np.outer(direction, direction) + np.eye(3))
    return CombinedCentre(
        centre_mm=centre_mm,
        covariance_mm2=0.5 * (covariance + covariance.T),
        agreement_mm=float(np.linalg.norm(difference)),
        radius_mm=ball.radius_mm,
    )


def is_streaked(edge: RadialEdge, ball: BlurredBall) -> bool:
    """Whether streaks bend the background so much that neither fit's covariance can be trusted."""
    apart_mm = float(np.linalg.norm(edge.centre_mm - ball.centre_mm))
    bent = ball.streak_hu > STREAKED * abs(ball.contrast_hu)
    return bent or apart_mm > AGREEMENT_MM or _is_spoiled(edge, ball)


def _is_spoiled(edge: RadialEdge, ball: BlurredBall) -> bool:
    low, high = RADIUS_ABOVE_EDGES
    above = ball.radius_mm / edge.radius_mm - 1.0
    return edge.surface_share >= ENOUGH_SURFACE and not low < above < high


def _by_edges(edge: RadialEdge, ball: BlurredBall, spacing_mm: Array) -> CombinedCentre:
    streaks = ball.streak_hu / abs(edge.inside_hu - edge.outside_hu)
    covariance = _edge_covariance(edge, spacing_mm, streaks)
    distance_mm = float(np.linalg.norm(edge.centre_mm - ball.centre_mm))
    return CombinedCentre(edge.centre_mm, 0.5 * (covariance + covariance.T), distance_mm, edge.radius_mm)


def _edge_covariance(edge: RadialEdge, spacing_mm: Array, streaks: float) -> Array:
    """Covariance with streak bend terms this large relative to the contrast."""
    interpolation = np.diag((INTERPOLATION_ERROR_PER_MM * spacing_mm**2) ** 2)
    streaks_mm = EDGE_STREAK_ERROR_MM * streaks
    return RAY_CORRELATION * edge.covariance_mm2 + interpolation + streaks_mm**2 / 3.0 * np.eye(3)


def _root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
