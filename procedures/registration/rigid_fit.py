"""Rigid transform between two point sets: least squares, or weighted by each pair's error ellipsoid.

The closed form (singular value decomposition) works on stacks of point sets, because a correspondence search
fits hundreds of candidates. Arun, Huang, Blostein 1987 with the determinant guard of Umeyama 1991: never a
reflection.

Unequal, anisotropic errors have no closed-form solution, so that solution starts a Gauss-Newton iteration on
the rotation vector and the translation (in the spirit of Balachandran and Fitzpatrick 2009): six normal
equations with the inverse covariances, five to eight steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.errors import NOT_CONVERGED
from ronna_hw.arrays import Array, Mask

MOST_STEPS = 50  # ordinary data converge in five to eight
MOST_HALVINGS = 30  # a step halved this often is zero
SETTLED = 1e-12  # radians, and mm per mm of coordinate: near rounding, far below any instrument


@dataclass(frozen=True)
class RigidFit:
    """Rigid fits to a stack of point sets; every field has the leading axes of the stack.

    `rotation` (..., 3, 3) is proper, `translation_mm` (..., 3). `spread_mm2` (..., 3) are the singular
    values of the cross-covariance sum, largest first: the set's extent along its three principal axes.
    `mirrored` (...) is true where a reflection would fit better than any rotation.
    """

    rotation: Array
    translation_mm: Array
    spread_mm2: Array
    mirrored: Mask


def fit_rigid(image_mm: Array, physical_mm: Array) -> RigidFit:
    """Fit physical <- image to points (..., n, 3) in mm by least squares."""
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
    """Convert a fit, (3, 3) and (3,), without normalizing, since the rotation is already orthogonal.

    Normalizing would cost as much as the fit.
    """
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, translation_mm
    return RigidTransform(matrix, normalize=False, copy=False)


def residuals(fit: RigidFit, image_mm: Array, physical_mm: Array) -> Array:
    """Return the residuals, measured minus mapped, (..., n, 3) mm in the physical frame."""
    mapped = image_mm @ np.swapaxes(fit.rotation, -1, -2) + fit.translation_mm[..., None, :]
    return np.asarray(physical_mm - mapped)


def reflection_sum_mm2(fit: RigidFit, squared_sum_mm2: Array) -> Array:
    """Return the squared residual sum of the best reflection, given that of the best rotation.

    Flipping the sign of the smallest axis changes the sum by four times its singular value.
    """
    change = np.where(fit.mirrored, -4.0, 4.0) * fit.spread_mm2[..., 2]
    return np.asarray(np.maximum(squared_sum_mm2 + change, 0.0))


def pose_jacobian(points_mm: Array, centre_mm: Array) -> Array:
    """Differentiate points (..., 3) by a rotation about `centre_mm` and a translation, giving (..., 3, 6).

    The first three columns are per radian about x, y, z of the physical frame, the last three per mm.
    """
    x, y, z = np.moveaxis(points_mm - centre_mm, -1, 0)
    jacobian = np.zeros((*x.shape, 3, 6))
    jacobian[..., 0, 1], jacobian[..., 0, 2] = z, -y
    jacobian[..., 1, 0], jacobian[..., 1, 2] = -z, x
    jacobian[..., 2, 0], jacobian[..., 2, 1] = y, -x
    jacobian[..., 3:] = np.eye(3)
    return jacobian


def fit_weighted(
    image_mm: Array, physical_mm: Array, covariance_mm2: Array, rotation: Array, translation_mm: Array
) -> tuple[Array, Array]:
    """Fit rotation (3, 3) and translation (3,) physical <- image by maximum likelihood, from a nearby start.

    `covariance_mm2` (n, 3, 3) is the total error of each pair in the physical frame. Raises REG-006.
    """
    weights: Array = np.asarray(np.linalg.inv(covariance_mm2), dtype=float)
    scale_mm = float(np.abs(physical_mm).max())
    cost = _cost(image_mm, physical_mm, weights, rotation, translation_mm)
    for _ in range(MOST_STEPS):
        mapped = image_mm @ rotation.T + translation_mm
        centre = mapped.mean(axis=0)
        jacobian = pose_jacobian(mapped, centre)
        projected = np.swapaxes(jacobian, -1, -2) @ weights
        normal = (projected @ jacobian).sum(axis=0)
        slope = (projected @ (physical_mm - mapped)[..., None]).sum(axis=0)[:, 0]
        step: Array = np.linalg.solve(normal, slope)
        for _ in range(MOST_HALVINGS):
            turn = np.asarray(Rotation.from_rotvec(step[:3]).as_matrix(), dtype=float)
            next_rotation = turn @ rotation
            next_translation = turn @ (translation_mm - centre) + centre + step[3:]
            next_cost = _cost(image_mm, physical_mm, weights, next_rotation, next_translation)
            if next_cost <= cost * (1.0 + SETTLED) + np.finfo(float).tiny:
                break
            step = 0.5 * step
        rotation, translation_mm, cost = next_rotation, next_translation, next_cost
        if np.abs(step[:3]).max() < SETTLED and np.abs(step[3:]).max() < SETTLED * scale_mm:
            return rotation, translation_mm
    raise NOT_CONVERGED(
        f"the weighted fit did not converge in {MOST_STEPS} steps", got=f"{np.abs(step).max():.3g}"
    )


def _cost(image: Array, physical: Array, weights: Array, rotation: Array, translation: Array) -> float:
    residual = physical - image @ rotation.T - translation
    return float(np.einsum("ni,nij,nj->", residual, weights, residual))
