"""Rigid transforms in plain NumPy, without SciPy, so that device processes start fast.

Matrices are (4, 4), in millimetres; quaternions are scalar first.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.calibration import PoseRecord

Array = NDArray[np.float64]
Matrix = Array
Vector = Array
Vectors = Array  # (n, 3)
Point = tuple[float, float, float]


def as_point(values: Iterable[float]) -> Point:
    """Convert an array (3,) to a tuple of plain floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def as_rounded_point(values: Iterable[float]) -> Point:
    """Convert an array (3,) to a tuple of plain floats, rounded to six decimals."""
    x, y, z = (round(float(value), 6) for value in values)
    return x, y, z


def rotation_from_quaternion(quaternion_wxyz: ArrayLike) -> Matrix:
    """Return the rotation matrix (3, 3) of a quaternion, which need not be normalised."""
    w, x, y, z = np.asarray(quaternion_wxyz, dtype=float) / np.linalg.norm(quaternion_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: ArrayLike) -> Matrix:
    """Return the unit quaternion (4,) of a rotation matrix, with non-negative scalar (Shepperd's method)."""
    # Plain numbers: operations on single elements of an array take ten times as long.
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=float).tolist()
    trace = a + e + i
    largest = max(trace, a, e, i)  # decides which component is computed first
    if trace == largest:
        q = np.array([1 + trace, h - f, c - g, d - b])
    elif a == largest:
        q = np.array([h - f, 1 + 2 * a - trace, b + d, c + g])
    elif e == largest:
        q = np.array([c - g, b + d, 1 + 2 * e - trace, f + h])
    else:
        q = np.array([d - b, c + g, f + h, 1 + 2 * i - trace])
    unit: Matrix = q / sqrt(q.dot(q))
    return unit if unit[0] >= 0 else -unit


def matrix_from(translation_mm: ArrayLike, rotation: ArrayLike) -> Matrix:
    """Return the homogeneous matrix of a translation (3,) and a rotation matrix (3, 3)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_mm
    return matrix


def matrix_of(pose: PoseRecord) -> Matrix:
    """Return the homogeneous matrix of a pose record."""
    return matrix_from(pose.translation_mm, rotation_from_quaternion(pose.quaternion_wxyz))


def pose_of(matrix: ArrayLike) -> PoseRecord:
    """Return the pose record of a homogeneous matrix."""
    values = np.asarray(matrix, dtype=float)
    qw, qx, qy, qz = (float(v) for v in quaternion_from_rotation(values[:3, :3]))
    return PoseRecord(translation_mm=as_point(values[:3, 3]), quaternion_wxyz=(qw, qx, qy, qz))


def inverse(matrix: Matrix) -> Matrix:
    """Return the inverse of a rigid transform."""
    rotation = matrix[:3, :3].T
    return matrix_from(-rotation @ matrix[:3, 3], rotation)


def apply(matrix: Matrix, points_mm: ArrayLike) -> Matrix:
    """Transform points (3,) or (n, 3)."""
    return np.asarray(points_mm, dtype=float) @ matrix[:3, :3].T + matrix[:3, 3]


def rotation_from_vector(rotation_vector_rad: ArrayLike) -> Matrix:
    """Return the rotation matrix of an axis-angle vector (Rodrigues)."""
    vector = np.asarray(rotation_vector_rad, dtype=float)
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation: Matrix = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)
    return rotation


def rotation_towards(z_axis: ArrayLike, x_hint: ArrayLike) -> Matrix:
    """Return the rotation with third column `z_axis` and first column as close as possible to `x_hint`."""
    z = np.asarray(z_axis, dtype=float)
    z = z / np.linalg.norm(z)
    x = np.asarray(x_hint, dtype=float)
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    (x0, x1, x2), (z0, z1, z2) = x.tolist(), z.tolist()
    y = (z1 * x2 - z2 * x1, z2 * x0 - z0 * x2, z0 * x1 - z1 * x0)  # np.cross is ten times slower
    return np.array([x, y, z]).T.copy()


def vector_from_rotation(rotation: ArrayLike) -> Matrix:
    """Return the axis-angle vector (3,) of a rotation of less than half a turn."""
    w, *axis = quaternion_from_rotation(rotation)
    half_sine = float(np.linalg.norm(axis))
    if half_sine == 0.0:
        return np.zeros(3)
    vector: Matrix = np.array(axis) * (2.0 * np.arctan2(half_sine, w) / half_sine)
    return vector


def twice_sine_axis(rotation: Matrix) -> Matrix:
    """Return the axis of a rotation matrix, (3,), multiplied by twice the sine of the angle."""
    return np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
