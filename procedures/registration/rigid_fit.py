"""Least-squares rigid transform between two point sets, by singular value decomposition.

Works on stacks of point sets, because a correspondence search fits hundreds of candidates. Arun, Huang,
Blostein 1987 with the determinant guard of Umeyama 1991: never a reflection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidFit:
    """Fits of a stack of sets; every field has the leading axes of the stack.

    `rotation` (..., 3, 3) is proper, `translation_mm` (..., 3). `spread_mm2` (..., 3) are the singular
    values of the cross-covariance sum, largest first: the set's extent along its three principal axes.
    `mirrored` (...) is true where a reflection would fit better than any rotation.
    """

    rotation: Array
    translation_mm: Array
    spread_mm2: Array
    mirrored: NDArray[np.bool_]


def fit_rigid(image_mm: Array, physical_mm: Array) -> RigidFit:
    """Least squares fit physical <- image of points (..., n, 3) in mm."""
    image_centre = image_mm.mean(axis=-2, keepdims=True)
    physical_centre = physical_mm.mean(axis=-2, keepdims=True)
    cross = np.swapaxes(physical_mm - physical_centre, -1, -2) @ (image_mm - image_centre)
    left, spread, right = np.linalg.svd(cross)
    mirrored = np.linalg.det(left) * np.linalg.det(right) < 0.0
    left[..., :, 2] *= np.where(mirrored, -1.0, 1.0)[..., None]
    rotation = left @ right
    translation = physical_centre[..., 0, :] - np.squeeze(
        rotation @ np.swapaxes(image_centre, -1, -2), axis=-1
    )
    return RigidFit(rotation, translation, spread, np.asarray(mirrored))


def as_transform(rotation: Array, translation_mm: Array) -> RigidTransform:
    """The transform of one fit, (3, 3) and (3,), not normalized: a product of singular vectors is orthogonal.

    Normalizing would cost as much as the fit.
    """
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation_mm
    return RigidTransform(matrix, normalize=False, copy=False)


def residuals(fit: RigidFit, image_mm: Array, physical_mm: Array) -> Array:
    """Measured minus mapped, (..., n, 3) mm in the physical frame."""
    mapped = image_mm @ np.swapaxes(fit.rotation, -1, -2) + fit.translation_mm[..., None, :]
    return np.asarray(physical_mm - mapped)


def mirrored_sum_mm2(fit: RigidFit, squared_sum_mm2: Array) -> Array:
    """Squared residual sum of the best reflection, given the best rotation's `squared_sum_mm2`.

    Flipping the sign of the smallest axis changes the sum by four times its singular value.
    """
    change = np.where(fit.mirrored, -4.0, 4.0) * fit.spread_mm2[..., 2]
    return np.asarray(np.maximum(squared_sum_mm2 + change, 0.0))
