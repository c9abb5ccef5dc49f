"""Chi-square of a fit's residuals when its points share errors, and what it cannot show.

An error of the tool frame displaces all points together if the tool's orientation differs between them, and
does not average out like independent errors. It is judged with the full covariance of all coordinates.

What the pose explains leaves no residual. How far one displaced point puts a target off before the gate
notices is its external reliability (Baarda 1968, A testing procedure for use in geodetic networks).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from procedures.registration.error_theory import FreGate, degrees_of_freedom
from procedures.registration.target_prediction import influence_of_spheres
from procedures.registration.weighted_rigid_fit import pose_jacobian

Array = NDArray[np.float64]

DIRECTIONS = 2000  # 3 degrees apart: the worst is missed by 0.1 % at most
GOLDEN_ANGLE_RAD = np.pi * (3.0 - 5.0**0.5)


def chi_square_of_shared(
    residuals_mm: Array, fiducials_mm: Array, covariance_mm2: Array, shared_mm: Array
) -> float:
    """Chi-square, with 3n - 6 degrees of freedom, of the residuals (n, 3) mm of a rigid fit with any weights.

    `fiducials_mm` (n, 3) are the mapped points, `covariance_mm2` (n, 3, 3) is the independent part,
    `shared_mm` (n, 3, k) the displacement of every point by each of k unit errors. What a rigid motion can
    explain does not count.
    """
    residuals = residuals_mm.reshape(-1)
    return float(residuals @ _information(fiducials_mm, covariance_mm2, shared_mm) @ residuals)


@dataclass(frozen=True)
class UnnoticedPoint:
    """The point that, displaced alone, puts a target off furthest before the gate notices it."""

    index: int
    displaced_mm: float
    at_target_mm: float


def unnoticed_point(
    fiducials_mm: Array,
    target_mm: Array,
    covariance_mm2: Array,
    shared_mm: Array,
    weights: ArrayLike | None,
    gate: FreGate,
    largest_mm: float,
) -> UnnoticedPoint:
    """Find the worst single displacement, of at most `largest_mm`, that the gate passes every other time.

    Arguments as in `chi_square_of_shared`; `weights` (n, 3, 3) are those of the fit. The expected chi-square
    is then the limit: freedom plus what the displacement alone adds. Every direction is tried.
    """
    directions = _directions()
    count = len(fiducials_mm)
    information = _information(fiducials_mm, covariance_mm2, shared_mm).reshape(count, 3, count, 3)
    allowed = gate.chi_square_limit - degrees_of_freedom(count)
    worst = UnnoticedPoint(0, 0.0, 0.0)
    for index, influence in enumerate(influence_of_spheres(fiducials_mm, target_mm, weights)):
        seen = np.einsum("ki,ij,kj->k", directions, information[index, :, index], directions)
        displaced = np.minimum(largest_mm, np.sqrt(allowed / np.maximum(seen, allowed / largest_mm**2)))
        shift = displaced * np.linalg.norm(directions @ influence.T, axis=1)
        if shift.max() > worst.at_target_mm:
            worst = UnnoticedPoint(index, float(displaced[shift.argmax()]), float(shift.max()))
    return worst


def _information(fiducials_mm: Array, covariance_mm2: Array, shared_mm: Array) -> Array:
    """Inverse covariance (3n, 3n) of residuals, without what a rigid motion explains."""
    columns = shared_mm.reshape(-1, shared_mm.shape[-1])
    weight = np.linalg.inv(block_diag(*covariance_mm2) + columns @ columns.T)
    pose = pose_jacobian(fiducials_mm, fiducials_mm.mean(axis=0)).reshape(-1, 6)
    weighted = weight @ pose
    return np.asarray(weight - weighted @ np.linalg.solve(pose.T @ weighted, weighted.T))


def _directions() -> Array:
    """Directions (k, 3) evenly over a half sphere, by the golden angle."""
    number = np.arange(DIRECTIONS)
    height = (number + 0.5) / DIRECTIONS
    turn = number * GOLDEN_ANGLE_RAD
    radius = np.sqrt(1.0 - height**2)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
