"""Joint angles nearest to given ones that bring the tool origin to a point, in any orientation.

Minimise |q - q0| subject to p(q) = point, by sequential linearization: with the Jacobian J of the tool
origin, q <- q0 + pinv(J) (point - p(q) + J (q - q0)). At a fixed point q - q0 is in the row space of J, which
is the Lagrange condition.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.strategies.arm_in_branch import Joints
from procedures.strategies.errors import NoNearbyJoints
from ronna_hw.arm.kinematics import Kinematics

Array = NDArray[np.float64]

CONVERGED_RAD = 1e-10  # change of a step; 0.1 nm at 1 m
MOST_STEPS = 60  # 6 to 15 are usual; more means no convergence


def least_displacement(
    kinematics: Kinematics, tool_origin_mm: ArrayLike, start_rad: Joints, point_mm: ArrayLike
) -> Joints:
    """Joint angles nearest to `start_rad` with the tool origin (3,) mm in the flange at a point (3,) mm.

    Joint ranges are not checked. Raises STR-004 when no such joints are found near the start.
    """
    tool, point = np.asarray(tool_origin_mm, dtype=float), np.asarray(point_mm, dtype=float)
    start = np.asarray(start_rad)
    joints = start
    for _ in range(MOST_STEPS):
        position, jacobian = _tool_origin(kinematics, _six(joints), tool)
        wanted = point - position + jacobian @ (joints - start)
        try:
            following = start + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T, wanted)
        except np.linalg.LinAlgError:
            break
        step = float(np.abs(following - joints).max())
        joints = following
        if step < CONVERGED_RAD:
            return _six(joints)
        if not step < np.pi:  # also catches NaN
            break
    where = ", ".join(f"{value:.0f}" for value in point)
    raise NoNearbyJoints(f"no joint angles near those at the target bring the tool to ({where}) mm")


def _tool_origin(kinematics: Kinematics, joints_rad: Joints, tool_mm: Array) -> tuple[Array, Array]:
    """Tool origin (3,) mm in the robot frame, and its Jacobian (3, n) mm per rad."""
    flange = kinematics.forward(joints_rad)
    arm = np.reshape(flange.rotation, (3, 3)) @ tool_mm
    jacobian = kinematics.jacobian(joints_rad)
    return np.add(flange.position_mm, arm), jacobian[:3] + np.cross(jacobian[3:], arm, axis=0)


def _six(joints: Array) -> Joints:
    a, b, c, d, e, f = joints.tolist()
    return a, b, c, d, e, f
