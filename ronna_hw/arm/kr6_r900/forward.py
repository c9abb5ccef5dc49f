"""Forward kinematics and geometric Jacobian of the KR 6 R900, in closed form."""

from __future__ import annotations

from math import cos, sin
from typing import TYPE_CHECKING

from ronna_hw.arm.kr6_r900.dimensions import Dimensions
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector, Vector3

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def forward(arm: Dimensions, joints_rad: JointVector) -> Pose:
    """Pose of the flange in $ROBROOT; z points out of the flange.

    The chain is Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6) Ry(90 deg), multiplied out.
    """
    A1, A2, A3, A4, A5, A6 = joints_rad
    c1, s1 = cos(A1), sin(A1)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    c4, s4 = cos(A4), sin(A4)
    c5, s5 = cos(A5), sin(A5)
    c6, s6 = cos(A6), sin(A6)
    # Columns of the flange frame in the frame of the forearm (x along A4, y along A3, z across).
    x0, x1, x2 = -s5 * c6, -c4 * s6 - s4 * c5 * c6, s4 * s6 - c4 * c5 * c6
    y0, y1, y2 = -s5 * s6, c4 * c6 - s4 * c5 * s6, -s4 * c6 - c4 * c5 * s6
    z0, z1, z2 = c5, -s4 * s5, -c4 * s5
    # Rows of the forearm frame in $ROBROOT.
    r00, r01, r02 = c1 * c23, s1, c1 * s23
    r10, r11, r12 = -s1 * c23, c1, -s1 * s23
    r20, r22 = -s23, c23
    forward_mm = (
        arm.shoulder_offset_mm + arm.upper_arm_mm * cos(A2) + arm.forearm_mm * c23 + arm.elbow_offset_mm * s23
    )
    up_mm = arm.base_height_mm - arm.upper_arm_mm * sin(A2) - arm.forearm_mm * s23 + arm.elbow_offset_mm * c23
    az = r00 * z0 + r01 * z1 + r02 * z2
    bz = r10 * z0 + r11 * z1 + r12 * z2
    cz = r20 * z0 + r22 * z2
    hand = arm.flange_mm
    return Pose(
        (c1 * forward_mm + hand * az, -s1 * forward_mm + hand * bz, up_mm + hand * cz),
        (
            r00 * x0 + r01 * x1 + r02 * x2,
            r00 * y0 + r01 * y1 + r02 * y2,
            az,
            r10 * x0 + r11 * x1 + r12 * x2,
            r10 * y0 + r11 * y1 + r12 * y2,
            bz,
            r20 * x0 + r22 * x2,
            r20 * y0 + r22 * y2,
            cz,
        ),
    )


def jacobian(arm: Dimensions, joints_rad: JointVector) -> NDArray[np.float64]:
    """Geometric Jacobian of the flange in $ROBROOT, (6, 6): rows vx vy vz in mm, wx wy wz in rad, per rad."""
    import numpy as np  # for planning only: the real-time process goes without

    A1, A2, A3, A4, _, _ = joints_rad
    c1, s1 = cos(A1), sin(A1)
    c23, s23 = cos(A2 + A3), sin(A2 + A3)
    flange = forward(arm, joints_rad)
    along = (c1 * c23, -s1 * c23, -s23)
    sideways = (s1, c1, 0.0)
    across = (c1 * s23, -s1 * s23, c23)
    wrist_axis = _combine(across, -sin(A4), sideways, cos(A4))
    flange_axis = (flange.rotation[2], flange.rotation[5], flange.rotation[8])
    shoulder = (c1 * arm.shoulder_offset_mm, -s1 * arm.shoulder_offset_mm, arm.base_height_mm)
    upper = (c1 * cos(A2), -s1 * cos(A2), -sin(A2))
    elbow = _combine(upper, arm.upper_arm_mm, shoulder, 1.0)
    wrist = _combine(flange_axis, -arm.flange_mm, flange.position_mm, 1.0)
    chain: tuple[tuple[Vector3, Vector3], ...] = (
        ((0.0, 0.0, -1.0), (0.0, 0.0, arm.base_height_mm)),
        (sideways, shoulder),
        (sideways, elbow),
        (_combine(along, -1.0, along, 0.0), wrist),
        (wrist_axis, wrist),
        (_combine(flange_axis, -1.0, flange_axis, 0.0), wrist),
    )
    result = np.empty((6, 6))
    p = flange.position_mm
    for column, (axis, origin) in enumerate(chain):
        x, y, z = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
        a, b, c = axis
        result[:, column] = (b * z - c * y, c * x - a * z, a * y - b * x, a, b, c)
    return result


def _combine(u: Vector3, a: float, v: Vector3, b: float) -> Vector3:
    return (a * u[0] + b * v[0], a * u[1] + b * v[1], a * u[2] + b * v[2])
