"""The kinematic chain of an arm evaluated for many joint vectors at once, component by component."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.arm.kinematics import Chain, Joint

Array = NDArray[np.float64]
Components = tuple[Array, Array, Array]


def turned(joint: Joint, angle_rad: Array, point: Components) -> Components:
    """Points rotated about a joint axis by Rodrigues' formula; all arrays of one shape."""
    (x, y, z), (ax, ay, az) = point, joint.axis
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    along = (ax * x + ay * y + az * z) * (1.0 - cosine)
    return (
        x * cosine + (ay * z - az * y) * sine + ax * along,
        y * cosine + (az * x - ax * z) * sine + ay * along,
        z * cosine + (ax * y - ay * x) * sine + az * along,
    )


def mapped(matrix: Array, point: Components) -> Components:
    """Points multiplied by matrices (..., 3, 3) whose leading axes broadcast against the points'."""
    x, y, z = point
    first, second, third = (
        matrix[..., row, 0] * x + matrix[..., row, 1] * y + matrix[..., row, 2] * z for row in range(3)
    )
    return first, second, third


def shifted(point: Components, by: ArrayLike) -> Components:
    """Points plus vectors (..., 3) that broadcast against them."""
    vector = np.asarray(by, dtype=float)
    x, y, z = (part + vector[..., axis] for axis, part in enumerate(point))
    return x, y, z


def nominal_frames(chain: Chain, joints_rad: Array, tool_mm: Array) -> tuple[Array, Array]:
    """Tool points (..., 3) mm and orientations robot <- flange (..., 3, 3) of the nominal arm.

    `joints_rad` is (..., n), `tool_mm` (3,) in the flange frame.
    """
    flange = np.reshape(chain.flange_rotation, (3, 3))
    one = np.ones(joints_rad.shape[:-1])
    position: Components = tuple(part * one for part in flange @ tool_mm)
    axes: list[Components] = [tuple(part * one for part in flange[:, k]) for k in range(3)]
    for number in reversed(range(len(chain.joints))):
        joint, angle = chain.joints[number], joints_rad[..., number]
        position = turned(joint, angle, shifted(position, joint.to_next_mm))
        axes = [turned(joint, angle, axis) for axis in axes]
    position = shifted(position, chain.base_mm)
    rotation = np.stack([np.stack(axis, axis=-1) for axis in axes], axis=-1)
    return np.stack(position, axis=-1), rotation
