"""Validation of point sets and covariances before any computation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from procedures.registration.errors import (
    BAD_COVARIANCE,
    BAD_POINTS,
    DUPLICATE_POINTS,
    TOO_FEW_POINTS,
    BadParameter,
)
from ronna_hw.arguments import require_numbers
from ronna_hw.arrays import Array
from ronna_hw.frames import Transform, is_rotation

COORDINATE_LIMIT_MM = 1e6  # one kilometre: no theatre is larger, and squares are far from overflow
NEAREST_SPHERES_MM = 2.0  # two 11.5 mm spheres cannot be closer; a repeated detection is
SMALLEST_SPREAD_M = 0.01  # of markers: a set wider than this but no wider than two spheres may be in metres
OTHER_UNITS = 300.0  # ratio of the widths of two sets of the same points; metres for millimetres make 1000
FEWEST_PAIRS = 3  # a rigid transform has six unknowns; two points leave one undetermined
SYMMETRY_TOLERANCE = 1e-9  # relative; covariances are products, symmetric up to rounding


def validate_points(points_mm: ArrayLike, name: str) -> Array:
    """Return the points as a new float array (n, 3); an empty list becomes (0, 3). Raises REG-001."""
    values = require_numbers(points_mm, f"the {name} points", mistake=BAD_POINTS)
    if values.size == 0 and values.ndim <= 2:
        return np.zeros((0, 3))
    if values.ndim != 2 or values.shape[1] != 3:
        raise BAD_POINTS(f"the {name} points have shape {values.shape}", expected="(n, 3)")
    if not np.all(np.isfinite(values)):
        rows = np.flatnonzero(~np.isfinite(values).all(axis=1)).tolist()
        raise BAD_POINTS(f"the {name} points are not finite in row(s) {rows}")
    farthest_mm = float(np.abs(values).max(initial=0.0))
    if farthest_mm > COORDINATE_LIMIT_MM:
        words = f"the {name} points are farther away than any theatre is wide"
        raise BAD_POINTS(words, limit=f"{COORDINATE_LIMIT_MM:g} mm", got=f"{farthest_mm:g} mm")
    return values


def validate_targets(points_mm: ArrayLike) -> Array:
    """Return targets as (m, 3); one point (3,) becomes (1, 3). Raises REG-001."""
    try:
        single = np.shape(points_mm) == (3,)
    except ValueError:
        single = False
    return validate_points(np.reshape(points_mm, (1, 3)) if single else points_mm, "target")


def validate_transform(transform: RigidTransform | Transform | ArrayLike, name: str) -> RigidTransform:
    """Return a rigid transform given as such, with named frames, or as a matrix (4, 4) in mm.

    Raises REG-007.
    """
    rigid = transform.rigid if isinstance(transform, Transform) else transform
    if isinstance(rigid, RigidTransform):
        if rigid.single:
            return rigid
        got = f"{len(rigid)} transforms"
    else:
        try:
            matrix = np.asarray(rigid, dtype=float)
        except (TypeError, ValueError):
            got = type(rigid).__name__
        else:
            if _is_rigid(matrix):
                return RigidTransform.from_matrix(matrix)
            got = f"an array of shape {matrix.shape}"
    raise BadParameter(
        f"the {name} is no rigid transform",
        expected="a SciPy RigidTransform, a Transform, or a matrix (4, 4) with a proper rotation",
        got=got,
        action="Give one rigid transform; translations are in mm.",
    )


def _is_rigid(matrix: Array) -> bool:
    """Return whether a matrix is (4, 4), finite, with a proper rotation and nothing else in its last row."""
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return False
    return is_rotation(matrix[:3, :3]) and matrix[3].tolist() == [0.0, 0.0, 0.0, 1.0]


def validate_pairs(image_mm: ArrayLike, physical_mm: ArrayLike) -> tuple[Array, Array]:
    """Return two sets of equal length, with at least three distinct points, in the same units.

    Raises REG-001, 002, 004.
    """
    image, physical = validate_points(image_mm, "image"), validate_points(physical_mm, "physical")
    if len(image) != len(physical):
        raise BAD_POINTS(f"{len(image)} image points but {len(physical)} physical points")
    require_enough(image, "pair(s)")
    for name, points in (("image", image), ("physical", physical)):
        refuse_duplicates(points, name)
    refuse_other_units(image, physical)
    return image, physical


def refuse_other_units(image: Array, physical: Array) -> None:
    """Raise REG-001 if one of two sets of the same points is so much wider that it has other units."""
    sets = (("image", image), ("physical", physical))
    widths_mm = {name: float(np.ptp(points, axis=0).max()) for name, points in sets}
    (narrow, narrow_mm), (wide, wide_mm) = sorted(widths_mm.items(), key=lambda item: item[1])
    if wide_mm > OTHER_UNITS * narrow_mm:
        raise BAD_POINTS(
            f"the {wide} points are {wide_mm / narrow_mm:.0f} times as far apart as the {narrow} points",
            expected="the same points, in the same units",
            got=f"{wide_mm:.4g} and {narrow_mm:.4g}",
            action=f"Are the {narrow} points in metres? Give both in millimetres.",
        )


def require_enough(points: Array, name: str, action: str | None = None) -> None:
    """Raise REG-002 for fewer points than determine a rigid transform."""
    if len(points) < FEWEST_PAIRS:
        words = f"{len(points)} {name} given"
        raise TOO_FEW_POINTS(words, expected=f"at least {FEWEST_PAIRS}", action=action)


def refuse_duplicates(points: Array, name: str) -> None:
    """Raise REG-004 if two points in a set are closer than two spheres can be."""
    distances = np.linalg.norm(points[:, None] - points[None, :], axis=-1)
    np.fill_diagonal(distances, np.inf)
    if distances.min() < NEAREST_SPHERES_MM:
        spread_mm = float(np.ptp(points, axis=0).max())
        metres = SMALLEST_SPREAD_M < spread_mm < NEAREST_SPHERES_MM
        first, second = (int(index) for index in np.unravel_index(distances.argmin(), distances.shape))
        raise DUPLICATE_POINTS(
            f"{name} points {first} and {second} are the same sphere",
            limit=f"{NEAREST_SPHERES_MM:g} mm apart",
            got=f"{distances.min():.3g} mm",
            action="All are within 2 mm: are these metres? Give millimetres." if metres else None,
        )


def validate_covariances(covariance_mm2: ArrayLike, count: int) -> Array:
    """Return covariances (count, 3, 3) in mm2, symmetrized exactly. Raises REG-005."""
    values = require_numbers(covariance_mm2, "the covariances", mistake=BAD_COVARIANCE)
    if values.shape != (count, 3, 3):
        raise BAD_COVARIANCE(f"the covariances have shape {values.shape}", expected=f"({count}, 3, 3)")
    if not np.all(np.isfinite(values)):
        raise BAD_COVARIANCE("a covariance is not finite")
    transposed = values.transpose(0, 2, 1)
    if np.abs(values - transposed).max() > SYMMETRY_TOLERANCE * np.abs(values).max():
        raise BAD_COVARIANCE("a covariance is not symmetric")
    values = 0.5 * (values + transposed)
    smallest = np.linalg.eigvalsh(values)[:, 0]
    scale = np.trace(values, axis1=1, axis2=2)
    if np.any(smallest <= np.finfo(float).eps * np.abs(scale)):
        row = int(np.argmin(smallest))
        raise BAD_COVARIANCE(
            f"covariance {row} is not positive definite", got=f"smallest variance {smallest[row]:.3g} mm2"
        )
    return np.asarray(values, dtype=float)
