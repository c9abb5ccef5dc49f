"""Fits a tool's definition to its measured markers, as the unit does for every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]


def fit_body(body_mm: Vectors, measured_mm: Vectors) -> tuple[Vectors, Vectors, Vectors]:
    """Rotation (3, 3), translation (3,) and distances (n,) of the least-squares fit measured <- body.

    `body_mm` and `measured_mm` are (n, 3) with n >= 3, paired. Orthogonal Procrustes by SVD (Arun 1987)
    with Umeyama's sign, so that a mirror image is never returned.
    """
    count = len(body_mm)
    body_centre = body_mm.sum(axis=0) / count
    measured_centre = measured_mm.sum(axis=0) / count
    left, _, right = np.linalg.svd((measured_mm - measured_centre).T @ (body_mm - body_centre))
    if np.linalg.det(left) * np.linalg.det(right) < 0.0:
        left[:, 2] = -left[:, 2]
    rotation: Vectors = left @ right
    translation = measured_centre - rotation @ body_centre
    residuals = body_mm @ rotation.T + translation - measured_mm
    distances: Vectors = np.sqrt((residuals * residuals).sum(axis=1))
    return rotation, translation, distances
