"""Registration of point clouds without correspondence: principal axes, then iterative closest point (ICP).

For surfaces and dense scans; fiducials are paired by `match`, which states its certainty. Nearest neighbours
come from SciPy's k-d tree; every step uses the same rigid fit as the fiducials. Iterative closest points:
Besl and McKay 1992, trimmed to an overlap as in Chetverikov 2005.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from procedures.registration.correspondence import turn_rad
from procedures.registration.errors import (
    NOT_CONVERGED,
    SYMMETRIC_CLOUD,
    UNSOUND_REGISTRATION,
    BadParameter,
    CollinearPoints,
)
from procedures.registration.points import (
    FEWEST_PAIRS,
    refuse_other_units,
    require_enough,
    validate_points,
    validate_transform,
)
from procedures.registration.rigid_fit import as_transform, fit_rigid
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform

LINE_RATIO = 1e-3  # of the first two standard deviations; below it the cloud is a line
DISTINCT_AXES = 1.05  # ratio of successive standard deviations; below it an axis has no defined direction
CLEARLY_BETTER = 1.25  # ratio of any other orientation's residual to the best one's
SAME_TURN_RAD = np.radians(5.0)  # orientations closer than this are the same
ROUNDING_MM = 1e-6  # a smaller residual is zero
SETTLED_MM = 1e-7  # iteration stops when the residual changes by less
MOST_STEPS = 200


@dataclass(frozen=True)
class CloudFit:
    """Fit physical <- image of two clouds, with the rms distance to the nearest physical points.

    The residual says how similar the clouds are, not how accurate the registration is.
    """

    transform: RigidTransform
    residual_mm: float
    steps: int


def register_clouds(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    start: RigidTransform | Transform | ArrayLike | None = None,
    overlap: float = 1.0,
) -> CloudFit:
    """Register clouds (n, 3) and (m, 3) in mm, of any size and in any order.

    `start` is an approximate transform physical <- image, also as a matrix (4, 4) in mm. Without it the
    principal axes yield four, and both clouds must cover the same part. `overlap` is the share of the image
    points that have a counterpart. Raises REG-001, 002, 003, 006, 007; without a start also REG-009 when only
    a mirror image fits, REG-011 when several orientations fit.
    """
    image, physical = _validate_cloud(image_mm, "image"), _validate_cloud(physical_mm, "physical")
    if not 0.0 < overlap <= 1.0 or round(overlap * len(image)) < FEWEST_PAIRS:
        raise BadParameter(
            "the overlap must leave three points",
            limit="a share above 0, at most 1",
            got=f"{overlap}",
            action="Give the share of the image points that the physical ones cover.",
        )
    tree = cKDTree(physical)
    if start is not None:
        matrix = np.asarray(validate_transform(start, "start").as_matrix())
        return _iterate_closest_points(image, physical, tree, matrix, overlap)
    refuse_other_units(image, physical)
    fits, reflected = (
        [_iterate_closest_points(cloud, physical, tree, one, overlap) for one in _align_axes(cloud, physical)]
        for cloud in (image, image @ np.diag([-1.0, 1.0, 1.0]))
    )
    best = min(fits, key=lambda fit: fit.residual_mm)
    nearest_mm = min(fit.residual_mm for fit in reflected)
    if best.residual_mm > CLEARLY_BETTER * nearest_mm + ROUNDING_MM:
        got = f"{nearest_mm:.3g} mm, else {best.residual_mm:.3g} mm"
        raise UNSOUND_REGISTRATION("the clouds fit better as a mirror image", got=got)
    for fit in fits:
        turns = (np.asarray(one.transform.as_matrix())[:3, :3] for one in (best, fit))
        differs = turn_rad(*turns) > SAME_TURN_RAD
        if differs and fit.residual_mm < CLEARLY_BETTER * best.residual_mm + ROUNDING_MM:
            got = f"{best.residual_mm:.3g} and {fit.residual_mm:.3g} mm"
            raise SYMMETRIC_CLOUD("two orientations fit equally well", got=got)
    return best


def closest_point_steps(image_mm: ArrayLike, physical_mm: ArrayLike) -> Iterator[tuple[Array, float]]:
    """Yield transform (4, 4) physical <- image and rms residual, mm, of every iteration until it settles.

    From the orientation of the principal axes that ends best. Raises as `register_clouds`, without judging
    whether other orientations fit as well.
    """
    image, physical = _validate_cloud(image_mm, "image"), _validate_cloud(physical_mm, "physical")
    tree = cKDTree(physical)
    runs = [list(_steps(image, physical, tree, one, len(image))) for one in _align_axes(image, physical)]
    yield from min(runs, key=lambda steps: steps[-1][1])


def _iterate_closest_points(
    image: Array, physical: Array, tree: cKDTree, start: Array, overlap: float
) -> CloudFit:
    """Alternate between pairing nearest points and fitting until the residual stops decreasing."""
    number, matrix, residual_mm = 0, start, np.inf
    for step in _steps(image, physical, tree, start, round(overlap * len(image))):
        number, (matrix, residual_mm) = number + 1, step
    return CloudFit(as_transform(matrix[:3, :3], matrix[:3, 3]), residual_mm, number)


def _steps(
    image: Array, physical: Array, tree: cKDTree, start: Array, kept: int
) -> Iterator[tuple[Array, float]]:
    matrix, before_mm = start, np.inf
    for _ in range(MOST_STEPS):
        distance, nearest = tree.query(image @ matrix[:3, :3].T + matrix[:3, 3])
        used = np.argsort(distance, kind="stable")[:kept]
        residual_mm = float(np.sqrt(np.square(distance[used]).mean()))
        yield matrix, residual_mm
        if before_mm - residual_mm < SETTLED_MM:
            return
        before_mm = residual_mm
        fit = fit_rigid(image[used], physical[nearest[used]])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = fit.rotation, fit.translation_mm
    raise NOT_CONVERGED("the closest points did not converge", limit=f"{MOST_STEPS} steps")


def _align_axes(image: Array, physical: Array) -> list[Array]:
    """Align the principal axes of two clouds in each of the four proper rotations."""
    image_axes, physical_axes = principal_axes(image, "image"), principal_axes(physical, "physical")
    starts = []
    for first, second in product((1.0, -1.0), repeat=2):
        sign = first * second * np.linalg.det(image_axes) * np.linalg.det(physical_axes)
        rotation = physical_axes @ np.diag([first, second, sign]) @ image_axes.T
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = physical.mean(axis=0) - rotation @ image.mean(axis=0)
        starts.append(matrix)
    return starts


def principal_axes(points: Array, name: str) -> Array:
    """Return the principal axes as columns, longest first. Raises REG-011 if two are equally long."""
    _, spread, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    if np.any(spread[:-1] < DISTINCT_AXES * spread[1:]):
        raise SYMMETRIC_CLOUD(f"two principal axes of the {name} cloud are equally long")
    return np.asarray(axes.T)


def _validate_cloud(points_mm: ArrayLike, name: str) -> Array:
    points = validate_points(points_mm, name)
    require_enough(points, f"{name} point(s)")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] <= LINE_RATIO * spread[0]:
        raise CollinearPoints(f"the {name} cloud is a line")
    return points
